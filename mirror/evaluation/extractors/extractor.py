"""The interface of extractors."""

from __future__ import annotations

from typing import Protocol

from mirror.arrays import Bool, UInt8


class ObjectExtractor(Protocol):
    """An extractor of the region of an edited object in a render, without knowing the object's requested position.

    Attributes:
        identity: name of the extractor, with a hash of its networks if it has any; results state it.
    """

    @property
    def identity(self) -> str:
        """The name of the extractor, with a hash of its networks if it has any."""
        ...

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """Extract the object's pixels.

        Args:
            edited: (H, W, 3), RGB: render with the object.
            background: (H, W, 3), RGB: render of the same view without the object.
            counted: (H, W) mask of the pixels that may belong to the object.
            name: path of the edited render in the submission.

        Returns:
            (H, W) mask of the object; all False if no object was found.
        """

    def fingerprint(self, name: str) -> str:
        """Hash the files that the mask of an edited render depends on; empty if only the renders matter.

        Args:
            name: path of the edited render in the submission.
        """
