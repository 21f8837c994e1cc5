"""A part of an image, in shares of its size."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from mirror.schema.documents import Document

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Rectangle(Document):
    """A part of every raster, in shares of its width and height."""

    left: Share
    top: Share
    right: Share
    bottom: Share

    @model_validator(mode="after")
    def _some(self) -> Rectangle:
        if self.left >= self.right or self.top >= self.bottom:
            raise ValueError("left < right and top < bottom")
        return self
