"""``python -m benchmarks calibration align [--draws N]``: passes of one street with errors of consumer GPS, aligned.

Five passes along the urban street, each on another day: by day, again by day with clouds, in rain, at dusk, by night.
One front camera, images 480 px wide every 2 m over 80 m. Recorded poses have a bias of 3 m in a random direction, a
random walk of 0.1 m a root of a second, and 2 degrees of heading to either side. Errors are those between passes: the
pose of an image relative to the nearest image of the first pass, against the exact one. A common error of all passes
cannot be seen.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.calibration.verbs import run_verb
from benchmarks.report import Row
from benchmarks.synth_matching.posed_images import urban_drive
from mirror.arrays import Float64, Int64
from mirror.geometry import (
    Poses,
    angle_between_deg,
    interpolate,
    matrix_from_quaternion,
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_multiply,
)
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import to_pose_numbers
from mirror.recordings.assembly.assemble import encode_poses
from mirror.recordings.calibration import Calibration, to_calibration
from mirror.recordings.folder_lens import write_calibrations
from mirror.recordings.protocol import Track

CAMERA: Final = "front_wide"
PASSES: Final = (
    ("day", "day", "clear", "2025-05-14"),
    ("day-2", "day", "clouds", "2025-08-20"),
    ("rain", "day", "rain", "2025-06-11"),
    ("dusk", "dusk", "clear", "2025-07-02"),
    ("night", "night", "clear", "2025-11-19"),
)
"""Name, light, weather and date of each pass."""
_WIDTH_PX: Final = 480
_STEP_M: Final = 2.0
_WAY_M: Final = 80.0
_POSE_HZ: Final = 10
_BIAS_M: Final = 3.0
_WALK_M: Final = 0.1
_HEADING_DEG: Final = 2.0
_SECOND_NS: Final = 1_000_000_000


def render_passes(folder: Path, count: int = len(PASSES)) -> None:
    """Render the images of the first passes, each once; a pass that is there is kept."""
    import cv2

    for number, (name, light, weather, date) in enumerate(PASSES[:count]):
        own = folder / name
        if (own / "truth.npz").is_file():
            continue
        drive = urban_drive("along", light, weather, date=date, width_px=_WIDTH_PX, visit=number)  # type: ignore[arg-type]
        seconds = np.arange(0.0, drive.truth.duration_s, 0.05)
        driven = drive.truth.driven_m(seconds)
        at = 0.5 * (driven[-1] - _WAY_M) + np.arange(0.0, _WAY_M, _STEP_M)
        stamps = drive.condition.start_ns + np.round(np.interp(at, driven, seconds) * 1e6).astype(np.int64) * 1000
        drive.prepare()
        shutil.rmtree(own, ignore_errors=True)
        (own / "images").mkdir(parents=True)
        for stamp in stamps.tolist():
            image = drive.render(CAMERA, stamp, drive.at(stamp)).bgr
            cv2.imwrite(str(own / "images" / f"{stamp}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 92])
        first, last = int(stamps[0]) - _SECOND_NS, int(stamps[-1]) + _SECOND_NS
        times = np.arange(first, last, _SECOND_NS // _POSE_HZ, dtype=np.int64)
        poses = drive.world_SE3_ego(times)
        mounting, lens = drive.vehicle.ego_SE3_camera[CAMERA], drive.vehicle.cameras[CAMERA]
        calibration = to_calibration(CAMERA, lens, to_pose_numbers(mounting), "exact").model_dump(mode="json")
        place = {"longitude_deg": drive.roi.longitude_deg, "latitude_deg": drive.roi.latitude_deg}
        (own / "calibration.json").write_text(json.dumps({"calibration": calibration, **place}))
        truth = drive.world_SE3_ego(stamps)
        np.savez(
            own / "truth.npz", stamps=stamps, rotation=truth.rotation, translation=truth.translation, times=times,
            pose_rotation=poses.rotation, pose_translation=poses.translation,
        )  # fmt: skip
        drive.forget()


def _worsen(poses: Poses, times: Int64, heading_deg: float, rng: np.random.Generator) -> Poses:
    """Return poses as a consumer receiver records them: bias, random walk, heading."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    bias = _BIAS_M * np.array([np.cos(angle), np.sin(angle), 0.5 * rng.normal()])
    steps = rng.normal(0.0, _WALK_M * np.sqrt(1.0 / _POSE_HZ), (len(times), 3)) * (1.0, 1.0, 0.3)
    turn = quaternion_exp(np.array([[0.0, 0.0, np.radians(heading_deg)]]))
    rotation = quaternion_multiply(np.repeat(turn, len(times), axis=0), poses.rotation)
    return Poses(rotation, poses.translation + bias + np.cumsum(steps, axis=0))


def true_track(rendered: Path, name: str) -> tuple[Int64, Poses, TangentFrame]:
    """Return the exact poses of a pass with their times and frame."""
    truth, said = np.load(rendered / name / "truth.npz"), _notes(rendered, name)
    frame = TangentFrame(said["longitude_deg"], said["latitude_deg"])
    return truth["times"], Poses(truth["pose_rotation"], truth["pose_translation"]), frame


def biased_track(rendered: Path, number: int, draw: int) -> tuple[Int64, Poses, TangentFrame]:
    """Return the poses of a pass with errors that a draw seeds."""
    times, poses, frame = true_track(rendered, PASSES[number][0])
    rng = np.random.default_rng([draw, number, 7])
    return times, _worsen(poses, times, _HEADING_DEG * (-1) ** number, rng), frame


def write_recording(rendered: Path, own: Path, number: int, times: Int64, poses: Poses, frame: TangentFrame) -> None:
    """Write a pass as a recording with these poses."""
    name, light, weather, _ = PASSES[number]
    longitude, latitude, height = frame.to_geodetic(poses.translation)
    local = frame.world_R_enu(longitude, latitude)
    rotation = quaternion_from_matrix(np.swapaxes(local, 1, 2) @ matrix_from_quaternion(poses.rotation))
    track = Track(times, longitude, latitude, height_m=height, rotation=rotation)
    shutil.copytree(rendered / name / "images", own / "images" / CAMERA)
    (own / "poses.csv").write_bytes(encode_poses(track))
    write_calibrations(own, [Calibration.model_validate(_notes(rendered, name)["calibration"])])
    document = {
        "format": "mirror-folder", "version": "1.0", "drive_id": name, "vehicle_id": f"v{number}",
        "vehicle_type": "saloon", "rig_id": "front", "time_base": "unix_ns", "frame": {"kind": "wgs84"},
        "reference_camera": CAMERA, "cameras": {CAMERA: {}}, "light": light,
        "weather": weather,
    }  # fmt: skip
    (own / "recording.json").write_text(json.dumps(document))


def ingest_passes(rendered: Path, recordings: Path, dataset: Path) -> None:
    """Make a dataset of one scene around the middle of the way."""
    middle = np.load(rendered / PASSES[0][0] / "truth.npz")["translation"].mean(axis=0)
    frame = true_track(rendered, PASSES[0][0])[2]
    lon, lat, _ = frame.to_geodetic(middle[None])
    run_verb("ingest", recordings, "--roi", f"{lon[0]},{lat[0]},70,street", "--min-duration-s", 3, "--out", dataset)


def _notes(rendered: Path, name: str) -> Any:
    return json.loads((rendered / name / "calibration.json").read_text())


def relative_errors(
    rendered: Path, found: dict[str, tuple[Int64, Poses]], name: str, base: str
) -> tuple[Float64, Float64]:
    """Return the errors (M,) in metres and degrees of a pass' images relative to the nearest images of another pass."""
    one, other = np.load(rendered / name / "truth.npz"), np.load(rendered / base / "truth.npz")
    apart = np.linalg.norm(one["translation"][:, None] - other["translation"][None], axis=2)
    pairs = [(row, int(apart[row].argmin())) for row in range(len(apart)) if apart[row].min() < 6.0]
    here, there = (np.array(side, np.int64) for side in zip(*pairs))
    true = (
        Poses(other["rotation"], other["translation"])[there].inverse()
        @ Poses(one["rotation"], one["translation"])[here]
    )
    mine = interpolate(*found[name], one["stamps"])[here]
    base_poses = interpolate(*found[base], other["stamps"])[there]
    made = base_poses.inverse() @ mine
    return np.linalg.norm(made.translation - true.translation, axis=1), angle_between_deg(made.rotation, true.rotation)


def read_poses(dataset: Path, layer: str) -> dict[str, tuple[Int64, Poses]]:
    """Return the poses of the passes by drive in a layer of a dataset."""
    from mirror.dataset import open as open_dataset

    opened = open_dataset(dataset)
    drives = {row["traversal_id"]: row["drive_id"] for row in opened.table("traversals").to_pylist()}
    found = {}
    for traversal, drive in drives.items():
        view = opened.with_layers(poses=layer).where(traversal=traversal)
        frames = view.frames()
        found[drive] = frames[0].track
    return found


def align_rows(draws: int, folder: Path) -> Iterator[Row]:
    """Yield the errors between passes before and after the alignment.

    Args:
        draws: number of draws of the recorded errors.
        folder: folder of the rendered passes, which are kept.
    """
    render_passes(folder)
    errors: dict[tuple[str, str], list[tuple[Float64, Float64]]] = {}
    spent = 0.0
    for draw in range(draws):
        work = folder / f"draw-{draw}"
        shutil.rmtree(work, ignore_errors=True)
        for number, (name, *_) in enumerate(PASSES):
            write_recording(folder, work / "recordings" / name, number, *biased_track(folder, number, draw))
        dataset = work / "dataset"
        ingest_passes(folder, work / "recordings", dataset)
        start = time.process_time()
        run_verb("align", dataset, partly=True)
        spent += time.process_time() - start
        for layer in ("recorded", "aligned@1"):
            found = read_poses(dataset, layer)
            for name, *_ in PASSES[1:]:
                errors.setdefault((layer, name), []).append(relative_errors(folder, found, name, PASSES[0][0]))
    for (layer, name), own in errors.items():
        metres, degrees = (np.concatenate(side) for side in zip(*own))
        text = (
            f"median {np.median(metres):.3f} m, {np.median(degrees):.3f} degrees;"
            f" 95th percentile {np.percentile(metres, 95):.3f} m"
        )
        print(f"{layer} {name}: {text}")
        time_ms, error = spent / draws * 1e3, float(np.median(metres))
        yield Row(f"align {layer}: day to {name}", f"{len(metres)} images", time_ms, error, unit="m")
