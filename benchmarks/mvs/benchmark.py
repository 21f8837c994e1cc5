"""Measures depth, ground and sky without networks against the synthetic street's exact truth.

``python -m benchmarks mvs [--dataset D --recordings R --split S --preset P]``. Without a dataset, a street is
generated, ingested and split first. Layers that a dataset already has are measured unchanged. Truth needs recordings
made with ``--truth depth,semantic``. Times are processor times of all cores for one image.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

import mirror
from benchmarks.mvs.truth import TrueImage, resample_nearest, sample_true_image
from benchmarks.report import Row, report
from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.ground import FittedGround, compute_wheel_contacts, fit_ground
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from hybridworldsim.mvs.run import initialise
from mirror.arrays import Float64
from mirror.cli.main import main as mirror_command
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.geometry.poses import COLUMNS, Poses
from mirror.progress import progress_bar
from mirror.synth.fleet.drives import make_drive
from mirror.synth.model import Label
from mirror.synth.truth import Truth

_EDGES_M: Final = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)
_FROM_LINE_M: Final = (0.0, 1.0, 3.0, 6.0, 12.0, 30.0)
_SIZES: Final = ((240, 135, 64), (240, 135, 128), (480, 270, 128))
# 400 images in two minutes on two cores.
_MS_64: Final = 600.0
_EVERY: Final = 3


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks mvs")
    parser.add_argument("--dataset", type=Path, help="default: a small street is made")
    parser.add_argument("--recordings", type=Path, help="from which it was ingested, with truth")
    parser.add_argument("--split", default="novel")
    parser.add_argument("--preset", default="quick", help="of the recordings; seed 0")
    parser.add_argument("--traversal", action="append", help="only this training traversal; may be repeated")
    parser.add_argument("--version", help="of the layers; default: the split's name")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        if options.dataset is None:
            options.dataset, options.recordings = _street(Path(folder), options.preset, options.split)
        with progress_bar(quiet=False) as bar:
            part = mirror.open(options.dataset).where(traversal=options.traversal)
            made = initialise(part, options.split, version=options.version, progress=bar)
        dataset = mirror.open(options.dataset).where(split=options.split, role="train", traversal=options.traversal)
        dataset = dataset.with_layers(depth=made.layer, points=made.layer)
        measured = _MeasuredImages(dataset, options.recordings, made.layer)
        groups = {
            "time": _times(),
            "confirmed depth": measured.depth(),
            "ground": _ground(dataset, options.preset),
            "sky": measured.sky(),
        }
        return report("mvs", groups, errors="error")


def _street(folder: Path, preset: str, split: str) -> tuple[Path, Path]:
    recordings, dataset = folder / "recordings", folder / "dataset"
    synth = ["synth", "--preset", preset, "--scenes", "1", "--truth", "depth,semantic", "--out", str(recordings)]
    drives = sorted(path.parent for path in recordings.glob("*/recording.json"))
    for words in (
        synth,
        [
            "ingest",
            *map(str, drives or [recordings]),
            "--rois",
            str(recordings / "rois.geojson"),
            "--out",
            str(dataset),
        ],
        ["split", str(dataset), split, "--method", "novel-traversal"],
    ):
        if code := mirror_command(words):
            raise SystemExit(code)
    return dataset, recordings


def _times() -> Iterator[Row]:
    """Times on images of noise, with neighbours of the same noise."""
    for width, height, planes in _SIZES:
        images = [_noise(width, height, x) for x in (0.0, -1.0, 1.0, -2.0, 2.0)]
        sweep = PlaneSweep(planes=planes, road_planes=0 if planes == 64 else PlaneSweep.road_planes)
        sweep(images[0], images[1:], 2.0, 200.0)
        start = time.process_time()
        for _ in range(3):
            sweep(images[0], images[1:], 2.0, 200.0)
        spent = 1e3 * (time.process_time() - start) / 3
        yield Row(
            f"plane sweep, {planes} planes, 4 sources",
            f"{width} x {height} px",
            spent,
            bar=_MS_64 if planes == 64 else None,
        )


def _noise(width: int, height: int, x_m: float) -> StereoImage:
    rgb = np.random.default_rng(0).integers(0, 255, (height, width, 3)).astype(np.uint8)
    K = np.array([[0.5 * width, 0.0, width / 2], [0.0, 0.5 * width, height / 2], [0.0, 0.0, 1.0]])
    pose = np.array([[1.0, 0, 0, x_m], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
    return StereoImage(rgb, K, Poses.from_matrix(pose), np.ones((height, width), np.bool_))


class _MeasuredImages:
    """Every third image of the training traversals, with its truth."""

    def __init__(self, dataset: Dataset, recordings: Path, layer: str) -> None:
        self._dataset, self._recordings, self._layer = dataset, recordings, layer
        rows = dataset.table("traversals", ["traversal_id", "drive_id", "light"]).to_pylist()
        self._of = {row["traversal_id"]: (row["drive_id"], row["light"]) for row in rows}

    def depth(self) -> Iterator[Row]:
        """Relative errors by distance."""
        errors: list[list[Float64]] = [[] for _ in _EDGES_M[1:]]
        there = np.zeros(len(_EDGES_M) - 1, np.int64)
        in_sky, known_px = 0, 0
        for _, image, truth in self._truth_images():
            depth = image.depth()
            if depth is None:
                continue
            found = depth.decode().astype(np.float64)
            known = np.isfinite(found)
            known_px, in_sky = known_px + int(known.sum()), in_sky + int((known & np.isinf(truth.depth_m)).sum())
            with np.errstate(invalid="ignore"):
                error = np.abs(found - truth.depth_m) / truth.depth_m
            for number, (low, high) in enumerate(pairwise(_EDGES_M)):
                ring = (truth.depth_m >= low) & (truth.depth_m < high)
                there[number] += int(ring.sum())
                errors[number].append(error[ring & known])
        for number, (low, high) in enumerate(pairwise(_EDGES_M)):
            every = np.concatenate(errors[number])
            shares = [100.0 * float((every < most).mean()) if len(every) else 0.0 for most in (0.03, 0.1)]
            size = f"{100.0 * len(every) / max(int(there[number]), 1):.0f} % known"
            name = f"{low:g}-{high:g} m: {shares[0]:.0f} % within 3 %, {shares[1]:.0f} % within 10 %"
            yield Row(name, size, 0.0, 100.0 * float(np.median(every)) if len(every) else None, unit="% (median)")
        yield Row("depths given to the sky", f"{known_px} px", 0.0, 100.0 * in_sky / max(known_px, 1), unit="%")

    def sky(self) -> Iterator[Row]:
        """Intersection over union of the sky, by light."""
        counts: dict[str, list[int]] = {}
        for light, image, truth in self._truth_images():
            masks = [mask for mask in image.masks() if f"{mask.source}@{mask.source_version}" == self._layer]
            depth = image.depth()
            if not masks or depth is None:
                continue
            found = resample_nearest(masks[0].decode(), image.camera_model, depth.lens, 0) > 0
            true = truth.label == int(Label.SKY)
            own = counts.setdefault(light, [0, 0, 0])
            for place, part in enumerate((found & true, found & ~true, ~found & true)):
                own[place] += int(part.sum())
        for light, (hit, extra, missed) in sorted(counts.items()):
            name = f"{light}: precision {hit / max(hit + extra, 1):.2f}, recall {hit / max(hit + missed, 1):.2f}"
            yield Row(name, f"{hit + missed} px", 0.0, 1.0 - hit / max(hit + extra + missed, 1), unit="1 - IoU")

    def _truth_images(self) -> Iterator[tuple[str, Image, TrueImage]]:
        number = 0
        for frame in self._dataset.frames():
            drive, light = self._of[frame.traversal_id]
            for camera, image in frame.images.items():
                number += 1
                depth = image.depth()
                if number % _EVERY == 0 and depth is not None:
                    truth = Truth(self._recordings / drive)
                    yield (
                        light,
                        image,
                        sample_true_image(truth, camera, image.timestamp_ns, image.camera_model, depth.lens),
                    )


def _ground(dataset: Dataset, preset: str) -> Iterator[Row]:
    """Height errors of the ground, from poses alone and with points, by distance from the nearest driven line."""
    scene, drive = (
        dataset.table("traversals", ["scene_id", "drive_id"]).column(name)[0].as_py()
        for name in ("scene_id", "drive_id")
    )
    own = dataset.where(scene=scene)
    world = make_drive(preset, 0, drive).world
    driven = compute_wheel_contacts(Poses.from_columns(own.table("ego_poses", COLUMNS)))
    start = time.process_time()
    from_poses = fit_ground(driven)
    spent = 1e3 * (time.process_time() - start)
    points = own.points()
    start = time.process_time()
    with_points = fit_ground(driven, points.position_m)
    for label, ground, ms in (
        ("poses alone", from_poses, spent),
        (f"poses and {len(points)} points", with_points, 1e3 * (time.process_time() - start)),
    ):
        yield from _height_errors(label, ground, driven, world.height_m, ms)


def _height_errors(
    label: str, ground: FittedGround, driven: Float64, true_height: Callable[[Float64, Float64], Float64], ms: float
) -> Iterator[Row]:
    from scipy.spatial import cKDTree

    middle = driven[len(driven) // 6, :2]
    grid = np.stack(np.meshgrid(np.arange(-40.0, 40.0), np.arange(-40.0, 40.0)), axis=-1).reshape(-1, 2) + middle
    away = cKDTree(driven[:, :2]).query(grid)[0]
    for low, high in pairwise(_FROM_LINE_M):
        place = grid[(away >= low) & (away < high)]
        error = np.abs(ground.height(place) - true_height(place[:, 0], place[:, 1]))
        name = f"{label}, {low:g}-{high:g} m from a wheel's way"
        yield Row(
            name,
            f"{len(place)} places",
            ms,
            100.0 * float(np.median(error)),
            unit=f"cm (90 %: {100 * np.quantile(error, 0.9):.0f})",
        )
