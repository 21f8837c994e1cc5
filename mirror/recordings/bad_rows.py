"""The rows of a recording that make no pose: dropped, and counted by reason.

`mirror.recordings.row_faults` finds and drops them. `mirror.ingest.usable` decides how many of them a drive may have.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final, Literal, get_args

from mirror.arrays import Int64, UInt8
from mirror.errors import RecordingError

Reason = Literal["cells", "number", "time", "rotation", "sigma", "file", "position"]
"""A line with too few or too many cells; a cell that is no number; no stamp; no rotation; no standard deviation; a row
of a damaged part of the drive; a position outside the range of its coordinates.
"""
REASONS: Final[tuple[Reason, ...]] = get_args(Reason)


@dataclass(frozen=True)
class BadRows:
    """The K rows that were dropped from a track.

    Attributes:
        before: (K,) ascending; the number of rows of the track that precede each dropped row.
        reason: (K,) index into `REASONS`.
        first: the error of the first dropped row, which names its file and line.
    """

    before: Int64
    reason: UInt8
    first: RecordingError

    def __len__(self) -> int:
        return len(self.before)

    def counts(self) -> dict[str, int]:
        """Return the number of dropped rows by reason."""
        return {REASONS[code]: count for code, count in sorted(Counter(self.reason.tolist()).items())}
