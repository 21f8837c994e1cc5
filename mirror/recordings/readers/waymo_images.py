"""Images of Waymo v2, which lie in rows of a Parquet file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.opening import unreadable_error
from mirror.recordings.readers.stored_poses import REMEDY

IMAGE: Final = "[CameraImageComponent]."
"""Prefix of the columns of images."""

_BATCH: Final = 16


@dataclass(frozen=True)
class ParquetStream:
    """Images in rows of a Parquet file; row groups without requested images are not decoded."""

    camera: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    file: Path
    rows: Int64 = field(repr=False)
    codec: str = "jpeg"

    def path(self, index: int) -> None:
        """Return None: the images lie in one file."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield the bytes of images.

        Raises:
            RecordingError: the file cannot be read, or an image is null.
        """
        import pyarrow.parquet as parquet

        wanted = {int(self.rows[index]): index for index in indices}
        waiting = list(indices)
        found: dict[int, bytes | None] = {}
        try:
            opened = parquet.ParquetFile(self.file)
            start = 0
            for group in range(opened.num_row_groups):
                end = start + opened.metadata.row_group(group).num_rows
                batches = opened.iter_batches(_BATCH, row_groups=[group], columns=[f"{IMAGE}image"])
                for batch in batches if any(start <= row < end for row in wanted) else ():
                    for place in range(batch.num_rows):
                        if start + place in wanted:
                            found[wanted[start + place]] = batch.column(0)[place].as_py()
                    start += batch.num_rows
                    # The rows of a camera are in order of time, so few images wait for an earlier one.
                    while waiting and waiting[0] in found:
                        index = waiting.pop(0)
                        yield index, self._image(found.pop(index), index)
                start = end
        except (OSError, pa.ArrowException) as error:
            raise unreadable_error(self.file, error) from error

    def _image(self, data: bytes | None, index: int) -> bytes:
        if not isinstance(data, bytes):
            raise RecordingError("no image", file=self.file, place=f"row {self.rows[index]}", remedy=REMEDY)
        return data
