"""A rectangle in an image, as shares of the image's width and height."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from mirror.schema.documents import Document

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Rectangle(Document):
    """A rectangle, as shares (0 to 1) of a raster's width and height."""

    left: Share
    top: Share
    right: Share
    bottom: Share

    @model_validator(mode="after")
    def _check_area(self) -> Rectangle:
        if self.left >= self.right or self.top >= self.bottom:
            raise ValueError("left < right and top < bottom")
        return self
