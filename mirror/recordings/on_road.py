"""Recordings whose ego frame lies at a sensor, put on the road by the sensor's height: the option ``height_m``.

`mirror reconstruct`, the simulator and others take the ego's line for the road. A source that states no height of the
body whose poses it has keeps the ego frame there and says so (`above_road_note`); with the option it lies below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.coordinates import to_ego_track
from mirror.recordings.protocol import DriveInfo, ImageStream, Recording, RigInfo, Track

OPTION: Final = "height_m"
_HIGHEST_M: Final = 10.0


def above_road(height_m: float) -> Poses:
    """Return ``ego_SE3_body`` of an upright body: the ego's origin lies on the road below it."""
    return Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, height_m]]))


def above_road_note(body: str) -> str:
    """Return the note of a recording whose ego frame lies at a body above the road."""
    return (
        f"the ego frame lies at the {body}, above the road, whose height the source does not state:"
        f" give --option {OPTION}=METRES to put it on the road below"
    )


def put_on_road(recording: Recording, options: Mapping[str, str], path: Path) -> Recording:
    """Return the recording with its ego frame on the road, if the options have the height; else the recording itself.

    Args:
        recording: a recording whose ego frame lies at the recorded body, upright.
        options: options of the reader.
        path: the recording, for the message.

    Raises:
        RecordingError: the option is no height.
    """
    text = options.get(OPTION)
    if text is None:
        return recording
    try:
        height = float(text)
    except ValueError:
        height = math.nan
    if not 0.0 < height <= _HIGHEST_M:
        raise RecordingError(
            f"{text!r} is no height", file=path, place=f"option {OPTION}", expected=f"metres, at most {_HIGHEST_M:g}"
        )
    return RecordingOnRoad(recording, height)


@dataclass(frozen=True)
class RecordingOnRoad:
    """A recording whose ego frame lies on the road below its recorded body.

    Attributes:
        body: the recording as it is read, with the ego frame at the body.
        height_m: height of the body above the road.
    """

    body: Recording
    height_m: float

    @cached_property
    def info(self) -> DriveInfo:
        """The drive as the source states it, without the note on the ego frame."""
        info = self.body.info
        notes = tuple(note for note in info.notes if note != above_road_note(info.body_frame))
        return replace(info, notes=notes)

    @property
    def rig(self) -> RigInfo | None:
        """The cameras."""
        return self.body.rig

    def files(self) -> Sequence[tuple[str, Path | str]]:
        """Return the files of the recording."""
        return self.body.files()

    def track(self) -> Track:
        """Return the poses of the ego frame on the road."""
        track = self.body.track()
        return replace(to_ego_track(track, above_road(self.height_m)), bad=track.bad, repeats=track.repeats)

    def calibrations(self) -> pa.Table:
        """Return the calibrations, raised by the height."""
        return self._raise(self.body.calibrations())

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images."""
        return self.body.images()

    def boxes(self) -> pa.Table | None:
        """Return the boxes, raised by the height; None: there are none."""
        table = self.body.boxes()
        return None if table is None else self._raise(table)

    def _raise(self, table: pa.Table) -> pa.Table:
        import pyarrow.compute as pc

        place = table.schema.get_field_index("tz_m")
        raised = pc.add(table.column("tz_m"), pa.scalar(self.height_m))
        return table.set_column(place, table.schema.field(place), raised)
