"""Images taken in gaps of the poses are left out and counted; the pose of every image that stays is known.

The reference is the circle that was driven, in closed form.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.ingest import main
from mirror.dataset.layout import Layout
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.ingest.request import IngestOptions, IngestReport
from mirror.ingest.run import ingest_recordings
from mirror.schema.documents import DriveDocument, Roi
from mirror.schema.files import read_json, read_table
from mirror.schema.tables import EGO_POSES, IMAGES
from tests.builders.folder import START_NS, folder_document

RADIUS_M, SPEED_MPS = 40.0, 15.0
YARD = Roi(scene_id="yard", frame="yard", x_m=0.0, y_m=0.0, radius_m=60.0)
BEYOND = Roi(scene_id="yard", frame="yard", x_m=0.0, y_m=-10.0, radius_m=48.0)
LENGTH_S = 40.0
STAMPS = START_NS + np.arange(0, int(LENGTH_S * 10)) * 100_000_000
IMAGES_NS = START_NS + np.arange(1, int(LENGTH_S * 4)) * 250_000_000 + 3_000_000


def place(stamps_ns: np.ndarray) -> np.ndarray:
    angle = (stamps_ns - START_NS) * 1e-9 * SPEED_MPS / RADIUS_M
    return RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle)])


def record(path: Path, lost: np.ndarray, *, is_clip: bool, wild: bool = False) -> Path:
    """A drive in circles: poses at 10 Hz but for the lost ones, which are absent or wild; images at 4 Hz."""
    (path / "images" / "front").mkdir(parents=True)
    cameras = {"rig_id": "one", "reference_camera": "front", "cameras": {"front": {}}}
    document = folder_document("circle", frame={"kind": "local", "name": "yard"}, is_clip=is_clip, **cameras)
    (path / "recording.json").write_text(json.dumps(document))
    lines = ["timestamp_ns,x_m,y_m"]
    for stamp, (x, y), gone in zip(STAMPS, place(STAMPS), lost):
        if not gone:
            lines.append(f"{stamp},{x},{y}")
        elif wild:
            lines.append(f"{stamp},{(stamp // 100_000_000) % 7 * 5e4 + 1e6},{y}")
    (path / "poses.csv").write_text("\n".join(lines) + "\n")
    data = cv2.imencode(".jpg", np.zeros((6, 8, 3), np.uint8))[1].tobytes()
    for stamp in IMAGES_NS:
        (path / "images" / "front" / f"{stamp}.jpg").write_bytes(data)
    return path


def stored(out: Path, report: IngestReport) -> tuple[np.ndarray, float]:
    """Stamps of the stored images, and how far their interpolated places are from the circle, at most."""
    stamps, worst = [], 0.0
    for one in report.traversals:
        folder = Layout(out).recorded(one.traversal_id)
        poses = read_table(folder / "ego_poses.parquet", EGO_POSES)
        columns = {name: poses.column(name).to_numpy() for name in poses.column_names if name[1:] != "_m"}
        world = Poses(
            np.column_stack([columns[name] for name in ("qw", "qx", "qy", "qz")]),
            np.column_stack([columns[name] for name in ("tx_m", "ty_m", "tz_m")]),
        )
        at = read_table(folder / "images.parquet", IMAGES, ["timestamp_ns"]).column("timestamp_ns").to_numpy()
        found = interpolate(poses.column("timestamp_ns").to_numpy(), world, at).translation[:, :2]
        worst = max(worst, float(np.linalg.norm(found - place(at), axis=1).max()))
        stamps.append(at)
    return np.sort(np.concatenate(stamps)), worst


def in_gap(lost: np.ndarray) -> np.ndarray:
    """Mark images between two poses with a lost one between them."""
    kept = STAMPS[~lost]
    before = np.searchsorted(kept, IMAGES_NS) - 1
    inside = (before >= 0) & (before + 1 < len(kept))
    return inside & (kept[np.minimum(before + 1, len(kept) - 1)] - kept[np.maximum(before, 0)] > 2_000_000_000)


@pytest.mark.parametrize("wild", [False, True])
def test_a_clip_has_no_images_in_its_gaps(wild: bool, tmp_path: Path) -> None:
    lost = (STAMPS > START_NS + 12_000_000_000) & (STAMPS < START_NS + 20_300_000_000)
    report = ingest_recordings([record(tmp_path / "drive", lost, is_clip=True, wild=wild)], [YARD], tmp_path / "d")
    assert not report.failures
    stamps, worst = stored(tmp_path / "d", report)
    left_out = in_gap(lost)
    within = STAMPS[-1] >= IMAGES_NS
    np.testing.assert_array_equal(stamps, IMAGES_NS[~left_out & within])
    # The chord of a tenth of a second; the images in the gap would have been tens of metres off.
    assert worst < SPEED_MPS * 0.1 / 8
    chord = np.linalg.norm(place(IMAGES_NS[left_out]) - 0.5 * (place(STAMPS[120:121]) + place(STAMPS[203:204])), axis=1)
    assert left_out.sum() == report.without_pose > 30
    assert chord.max() > 30.0
    document = read_json(Layout(tmp_path / "d").drive("circle") / "drive.json", DriveDocument)
    assert document.images_without_pose == left_out.sum()


def test_a_gap_within_the_limit_is_driven_straight(tmp_path: Path) -> None:
    lost = (STAMPS > START_NS + 12_000_000_000) & (STAMPS < START_NS + 14_000_000_000)
    report = ingest_recordings([record(tmp_path / "drive", lost, is_clip=True)], [YARD], tmp_path / "d")
    assert report.without_pose == 0
    longer = ingest_recordings([tmp_path / "drive"], [YARD], tmp_path / "e", IngestOptions(trigger={"max_gap_s": 1.9}))
    # Between 12 s and 14 s.
    assert longer.without_pose == 8


def test_an_excursion_that_was_not_recorded_has_no_images(tmp_path: Path) -> None:
    """Visits are joined across a short way outside, of which the poses are lost."""
    angle = (STAMPS - START_NS) * 1e-9 * SPEED_MPS / RADIUS_M
    outside = np.linalg.norm(place(STAMPS) - (0.0, -10.0), axis=1) > 48.0
    assert 0 < outside.sum() < len(STAMPS) / 2
    first = np.flatnonzero(outside & (angle < 2 * np.pi))
    lost = np.zeros(len(STAMPS), np.bool_)
    lost[first[1] : first[-1]] = True
    gap_s = (STAMPS[first[-1]] - STAMPS[first[0]]) * 1e-9
    trigger = {"join_gap_s": gap_s + 1.0, "min_overlap": 0.3}
    path = record(tmp_path / "drive", lost, is_clip=False)
    report = ingest_recordings([path], [BEYOND], tmp_path / "d", IngestOptions(trigger=trigger))
    stamps, worst = stored(tmp_path / "d", report)
    assert gap_s > 2.0
    assert report.without_pose == in_gap(lost).sum() > 0
    assert not np.isin(stamps, IMAGES_NS[in_gap(lost)]).any()
    assert worst < SPEED_MPS * 0.1 / 8


def test_the_verb_says_what_was_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost = (STAMPS > START_NS + 12_000_000_000) & (STAMPS < START_NS + 20_300_000_000)
    (tmp_path / "rois.csv").write_text("scene_id,frame,x_m,y_m,radius_m\nyard,yard,0,0,60\n")
    arguments = [str(record(tmp_path / "drive", lost, is_clip=True)), "--rois", str(tmp_path / "rois.csv"), "--out"]
    assert main([*arguments, str(tmp_path / "d")]) == 0
    assert f"left out: {in_gap(lost).sum()} image" in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "e"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images_without_pose"] == in_gap(lost).sum()
