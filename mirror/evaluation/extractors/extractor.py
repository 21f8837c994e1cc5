"""What an extractor is."""

from __future__ import annotations

from typing import Protocol

from mirror.arrays import Bool, UInt8


class Extractor(Protocol):
    """Finds the region of an edited object in a render. It is not told where the object was to be."""

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """The object's pixels.

        Args:
            edited: (H, W, 3), RGB: the render with the object.
            background: (H, W, 3): the same without it.
            counted: (H, W): pixels that may belong to it.
            name: path of the edited render in the submission.

        Returns:
            (H, W); empty where nothing was found.
        """
