"""A rectangle in an image, as shares of the image's width and height."""

from __future__ import annotations

import math
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

    def __str__(self) -> str:
        return f"columns {self.left:g} to {self.right:g}, rows {self.top:g} to {self.bottom:g}"

    def touched(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and columns of all pixels of a raster that the rectangle touches."""
        rows = slice(math.floor(self.top * height), math.ceil(self.bottom * height))
        return rows, slice(math.floor(self.left * width), math.ceil(self.right * width))

    def inside(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and columns of the pixels of a raster that lie wholly inside the rectangle."""
        rows = slice(math.ceil(self.top * height), math.floor(self.bottom * height))
        return rows, slice(math.ceil(self.left * width), math.floor(self.right * width))
