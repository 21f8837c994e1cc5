"""Masks that somebody else extracted, by whatever means, as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.errors import DatasetError, UsageError


class MaskFiles:
    """Reads masks: grey PNGs by the names of renders, 128 and more where the object is.

    Args:
        folder: of the masks, whose paths in it are those of renders below ``renders/``.

    Raises:
        UsageError: there is no such folder.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder)
        if not self._folder.is_dir():
            raise UsageError("no such folder of masks", file=folder, place="--extractor")

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """See `Extractor`.

        Raises:
            DatasetError: the mask is missing, broken or of another size.
        """
        file = self._folder / name.removeprefix("renders/")
        data = file.read_bytes() if file.is_file() else b""
        mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
        if mask is None or mask.shape != counted.shape:
            height, width = counted.shape
            raise DatasetError(
                "missing, broken or of another size", file=file, expected=f"a grey PNG of {width} x {height} px"
            )
        return np.asarray((mask > 127) & counted)
