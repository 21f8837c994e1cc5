"""Recordings whose ego frame is put on the road: cameras and boxes stay where they are in the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.geometry import Poses
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import COLUMNS
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from tests.recordings.formats.every import WRITERS


def in_world(recording: Recording, rows: list[dict[str, object]]) -> np.ndarray:
    """Places of cameras or boxes (M, 3) at the first pose, in its tangent frame without the option."""
    track = recording.track()
    assert track.rotation is not None and track.longitude_deg is not None and track.latitude_deg is not None
    height = np.nan_to_num(track.height_m)
    frame = TangentFrame(0.0, 0.0)
    place = frame.from_geodetic(track.longitude_deg[:1], track.latitude_deg[:1], height[:1])
    turn = frame.world_R_enu(track.longitude_deg[:1], track.latitude_deg[:1])
    mounts = Poses.from_columns({name: [row[name] for row in rows] for name in COLUMNS}).translation
    local = Poses(track.rotation[:1], np.zeros((1, 3))).transform(mounts)[0]
    return place + local @ turn[0].T


@pytest.mark.parametrize("name", ["kitti360", "boreas", "comma2k19"])
def test_the_ego_frame_moves_to_the_road_and_nothing_else_does(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path)
    above, below = open_recording(path), open_recording(path, options={"height_m": "1.25"})
    (note,) = (note for note in above.info.notes if "height_m" in note)
    assert "above the road" in note and not any("height_m" in note for note in below.info.notes)
    assert below.info.drive_id == above.info.drive_id and below.files() == above.files()
    first, second = above.track(), below.track()
    assert np.median(np.asarray(first.height_m) - np.asarray(second.height_m)) == pytest.approx(1.25, abs=0.02)
    tables = [(above.calibrations(), below.calibrations()), (above.boxes(), below.boxes())]
    for one, other in tables:
        if one is not None and other is not None and len(one):
            assert other.schema.equals(one.schema)
            places = in_world(above, one.to_pylist()), in_world(below, other.to_pylist())
            # Boxes are at other times than the first pose; all poses of the fixture have nearly the same attitude.
            assert np.abs(places[0] - places[1]).max() < 1e-6
    for wrong in ("-1", "low", "nan", "40"):
        with pytest.raises(RecordingError, match="height_m"):
            open_recording(path, options={"height_m": wrong})
