"""An extractor that reads masks from files, which any other program may have written."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.errors import DatasetError, UsageError
from mirror.recordings.raster import is_decodable
from mirror.weights.resolve import file_sha256


class MaskFiles:
    """An extractor that reads masks: grey PNGs in which values of 128 or more mark the object.

    Args:
        folder: folder of the masks; a mask has the same path in it as its render has below ``renders/``.

    Raises:
        UsageError: the folder does not exist.
    """

    identity: Final = "file"

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder)
        if not self._folder.is_dir():
            raise UsageError(
                "no such folder of masks",
                file=folder,
                place="--extractor",
                expected="file:FOLDER with a mask for each edited view",
                remedy="name another folder with --extractor",
            )

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """See `Extractor`.

        Raises:
            DatasetError: the mask is missing, damaged or of another size.
        """
        file = self._file(name)
        data = file.read_bytes() if file.is_file() else b""
        mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if is_decodable(data) else None
        if mask is None or mask.shape != counted.shape:
            height, width = counted.shape
            raise DatasetError(
                "missing, damaged or of another size",
                file=file,
                expected=f"a grey PNG of {width} x {height} px",
                remedy="write the mask of this view again",
            )
        return np.asarray((mask > 127) & counted)

    def fingerprint(self, name: str) -> str:
        """Hash the mask; empty if the mask is missing, which `extract` reports."""
        file = self._file(name)
        return file_sha256(file) if file.is_file() else ""

    def _file(self, name: str) -> Path:
        return self._folder / name.removeprefix("renders/")
