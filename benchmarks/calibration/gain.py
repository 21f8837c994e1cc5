"""Gain of refined calibrations in the PSNR of a reconstruction: ``python -m benchmarks calibration gain``.

One block of the synthetic street, driven three times by day, is reconstructed three times with the same number of steps
and the same seed, from three layers of calibrations of all its traversals:

- ``injected``: the online calibrations of the recordings, turned by 0.05 to 1.0 degrees about random axes;
- ``refined``: what `mirror calibrate refine` makes of them, from the images of all traversals;
- ``exact``: the true mountings and lenses.

Poses are the recorded ones, with their errors. Each model has depth and points of its own, estimated with its
calibrations, and is rendered with them. The truth is in the raster of the recorded lenses, the same for all models. The
command continues where an interrupted one stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

import mirror
from benchmarks.calibration.verbs import METRICS, run_verb, shorten_protocol
from benchmarks.report import Row
from mirror.arrays import Float64
from mirror.calibration.refinement.adjustment import rotations
from mirror.calibration.refinement.run import DEFAULT_CHOICE, refine_calibrations
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.dataset.traversal import CameraCalibration
from mirror.evaluation.result import RESULT, Result
from mirror.evaluation.submission.manifest import MANIFEST
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.methods.model_document import read_reconstruction
from mirror.schema.files import read_json, write_bytes
from mirror.schema.tables import CALIBRATIONS
from mirror.synth.fleet.drives import make_drive

PRESET: Final = "reconstruction"
SCENE: Final = "guangzhou-urban"
DRIVES: Final = ("01", "03", "05")
"""Three drives by day, in sun, rain and clouds; one of them is held out."""
WIDTH_PX: Final = 240
INJECTED_DEG: Final = (0.05, 1.0)
LAYERS: Final = ("injected", "refined", "exact")
KEYS: Final = {"training": "psnr", "novel": "psnr_invariant"}
"""The metric that decides in each group."""
_SEED: Final = 0
_VERSION: Final = "1"
_PROTOCOL: Final = "static-reconstruction"
_CHOICE: Final = replace(DEFAULT_CHOICE, step_m=6.0)
"""One image a second is taken every 5 to 8 m."""
_LENS: Final = ("fx_px", "fy_px", "cx_px", "cy_px")


def gain_rows(folder: Path, steps: int) -> Iterator[Row]:
    """Yield the errors of the layers, and the PSNR of the models.

    Args:
        folder: working folder: recordings, dataset, models, submissions and results.
        steps: training images of each model.
    """
    prepare(folder)
    for name in LAYERS:
        relative, whole = layer_errors_deg(mirror.open(folder / "dataset").with_layers(calibrations=_layer(name)))
        size = f"{len(whole)} cameras"
        yield Row(f"{name}: error relative to the reference camera, median (deg)", size, float(np.median(relative)),
                  float(relative.max()), unit="deg worst")  # fmt: skip
        yield Row(f"{name}: error to the vehicle, median (deg)", size, float(np.median(whole)), float(whole.max()),
                  unit="deg worst")  # fmt: skip
    found = {name: reconstruct(folder, name, steps) for name in LAYERS}
    for group, key in KEYS.items():
        for metric in METRICS:
            for name in LAYERS:
                yield Row(f"{name}: {group}, {metric} (dB)", f"{steps} steps", found[name][group, metric])
        injected, refined, exact = (found[name][group, key] for name in LAYERS)
        share = (exact - refined) / (exact - injected)
        yield Row(f"{group}: share of the loss in {key} that is left", f"{steps} steps", share, bar=0.5)
    for name in LAYERS:
        done = read_reconstruction(folder / "models" / name).done
        yield Row(f"{name}: processor time of training (s)", f"{steps} steps", done.core_s if done else np.nan)


def prepare(folder: Path) -> None:
    """Make the recordings, the dataset, its split and the three layers, as far as they are missing."""
    recordings, dataset = folder / "recordings", folder / "dataset"
    if not (recordings / "rois.geojson").is_file():
        run_verb("synth", "--out", recordings, "--preset", PRESET, "--scenes", 1, "--seed", _SEED, "--workers", 1)
    if not (dataset / "index" / "snapshots").is_dir():
        drives = [recordings / f"{SCENE}-{number}" for number in DRIVES]
        run_verb("ingest", *drives, "--rois", recordings / "rois.geojson", "--out", dataset, "--licence", "CC0-1.0")
    if not (dataset / "splits" / "novel.json").is_file():
        run_verb("split", dataset, "novel", "--train", len(DRIVES) - 1, "--seed", _SEED)
    _write_layers(mirror.open(dataset))
    # The models add masks of the sky, which are inputs of a refinement: a complete layer is not asked for again.
    if any(f"calibrations/{_layer('refined')}" not in row for row in _layers_of(mirror.open(dataset))):
        injected = mirror.open(dataset).with_layers(calibrations=_layer("injected"))
        refine_calibrations(injected, version=_VERSION, choice=_CHOICE)


def reconstruct(folder: Path, name: str, steps: int) -> Mapping[tuple[str, str], float]:
    """Train, render and score a model: its figures in dB by group and metric."""
    dataset, protocol = folder / "dataset", folder / "protocol.toml"
    model, submission, result = (folder / kind / name for kind in ("models", "submissions", "results"))
    if not protocol.is_file():
        write_bytes(protocol, shorten_protocol(_PROTOCOL, "calibration-gain", WIDTH_PX).encode())
    if not (result / RESULT).is_file():
        budget = ("--steps", steps, "--seed", _SEED, "--threads", 1, "--width", WIDTH_PX, "--device", "cpu")
        source = ("--initialise", "plane-sweep", "--calibrations", _layer(name))
        run_verb("reconstruct", dataset, "--split", "novel", "--scene", SCENE, *budget, *source, "--out", model)
        if not (submission / MANIFEST).is_file():
            run_verb(
                "render",
                dataset,
                model,
                "--split",
                "novel",
                "--protocol",
                protocol,
                "--device",
                "cpu",
                "--out",
                submission,
            )
        run_verb("evaluate", dataset, submission, "--protocol", protocol, "--out", result, "--workers", 1)
    figures = read_json(result / RESULT, Result).figures
    return {(one.group, one.metric): one.value for one in figures if one.level == "group" and one.value is not None}


def layer_errors_deg(dataset: Dataset) -> tuple[Float64, Float64]:
    """Return angles of the errors of all mountings: relative to the first camera of each rig, and to the vehicle."""
    relative, whole = [], []
    for traversal in dataset.traversals():
        used, true = _calibrations(dataset, traversal), _true_mountings(dataset, traversal)
        turns = [matrix_from_quaternion(one.ego_SE3_camera.rotation)[0] for one in used]
        truth = [matrix_from_quaternion(true[one.camera].rotation)[0] for one in used]
        whole += [b.T @ a for a, b in zip(turns, truth)]
        relative += [b.T @ truth[0] @ turns[0].T @ a for a, b in zip(turns[1:], truth[1:])]
    return _angles_deg(relative), _angles_deg(whole)


def _angles_deg(turns: list[Float64]) -> Float64:
    return np.asarray(np.degrees(np.linalg.norm(rotations(np.stack(turns)).log()[:, :3], axis=1)), np.float64)


def _write_layers(dataset: Dataset) -> None:
    """Write the layers with injected errors and with the truth of each traversal, if they are missing."""
    layout = Layout(Path(dataset.root))
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    missing = [
        (number, row["traversal_id"], name)
        for number, row in enumerate(rows)
        for name in ("injected", "exact")
        if f"calibrations/{_layer(name)}" not in row["layers"]
    ]
    if not missing:
        return
    with writer_lock(layout, wait=False):
        for number, traversal, name in missing:
            rng = np.random.default_rng([_SEED, number])
            true = _true_mountings(dataset, traversal)
            written = [
                _injected_row(one, rng) if name == "injected" else _exact_row(one, true, dataset, traversal)
                for one in _calibrations(dataset, traversal)
            ]
            LayerWriter(layout, traversal, "calibrations", name, _VERSION).finish(CALIBRATIONS, written, {})
        build_index(layout.root)


def _layers_of(dataset: Dataset) -> list[list[str]]:
    """The layers of each traversal."""
    rows: list[list[str]] = dataset.table("traversals", ["layers"]).column(0).to_pylist()
    return rows


def _injected_row(used: CameraCalibration, rng: np.random.Generator) -> dict[str, Any]:
    axis = rng.normal(size=3)
    turn = np.radians(rng.uniform(*INJECTED_DEG)) * axis / np.linalg.norm(axis)
    return {**used.row, **_pose_columns(used.ego_SE3_camera @ Poses.exp(np.concatenate([turn, np.zeros(3)])[None]))}


def _exact_row(used: CameraCalibration, true: Mapping[str, Poses], dataset: Dataset, traversal: str) -> dict[str, Any]:
    lens = make_drive(PRESET, _SEED, _drive(dataset, traversal)).vehicle.cameras[used.camera]
    return {**used.row, **_pose_columns(true[used.camera]), **{name: getattr(lens, name) for name in _LENS}}


def _pose_columns(pose: Poses) -> dict[str, float]:
    return {name: float(value[0]) for name, value in pose.to_columns().items()}


def _true_mountings(dataset: Dataset, traversal: str) -> Mapping[str, Poses]:
    mountings: Mapping[str, Poses] = make_drive(PRESET, _SEED, _drive(dataset, traversal)).vehicle.ego_SE3_camera
    return mountings


def _drive(dataset: Dataset, traversal: str) -> str:
    (row,) = dataset.where(traversal=traversal).table("traversals", ["drive_id"]).to_pylist()
    return str(row["drive_id"])


def _calibrations(dataset: Dataset, traversal: str) -> list[CameraCalibration]:
    """The calibration of each camera at the traversal's first frame, its best stage; the reference camera is first."""
    frame = dataset.where(traversal=traversal).frames()[0]
    used = [image.calibration for image in frame.images.values()]
    return sorted(used, key=lambda one: (one.camera != "front_wide", one.camera))


def _layer(name: str) -> str:
    return f"{name}@{_VERSION}"
