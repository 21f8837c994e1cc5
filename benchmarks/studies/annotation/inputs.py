"""The test of input statistics of the network that ships: learnt on its training streets, tried on others.

``python -m benchmarks annotation inputs --out FOLDER``: renders images of the training streets (preset ``annotation``,
seeds 1 to 3) and of held-out ones (other presets and seeds), and writes ``weights/inputs.json``. Held-out images are
compressed with qualities of 70 to 95 and partly scaled to 0.7; real images are read from ``MIRROR_REAL_DATA``. Rendered
images stay in the folder: an interrupted run continues.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hybridworldsim.petr.tiny.annotator import SHIPPED, SHIPPED_SHA256
from hybridworldsim.petr.tiny.familiarity import NAME, FamiliarInputs, fit_inputs, write_inputs
from hybridworldsim.petr.tiny.settings import NetworkSettings
from mirror.arrays import Bool, UInt8
from mirror.synth.fleet.drives import make_drives

TRAINED_ON: Final = "synthetic streets (mirror synth --preset annotation)"
TRAINING: Final = (("annotation", 1, 4, 3, 0), ("annotation", 2, 4, 3, 1), ("annotation", 3, 4, 3, 2))
"""Preset, seed, drives a scene, every how many of them, and which first."""
HELD_OUT: Final = (
    ("quick", 5, 5, 1, 0),
    ("demo", 7, 5, 1, 0),
    ("reconstruction", 4, 5, 2, 0),
    ("annotation", 21, 7, 4, 0),
)
REAL: Final = (
    "dgp_scene_02/rgb/*/*", "kitti_raw_91/*.jpg", "kitti_raw_91/*.png", "kitti_odometry_a/sequences/99/image_0/*",
    "opensfm_lund/images/*", "video/*.mp4",
)  # fmt: skip
_QUALITIES: Final = (70, 80, 90, 95)
_INSTANTS, _CAMERAS = 2, 3
_EVERY_FRAME: Final = 8


def fit_and_try(folder: Path) -> None:
    """Write the document beside the network that ships, and print the share of unfamiliar images by source."""
    training = [path for source in TRAINING for path in _render(folder, "fit", source)]
    inputs = fit_inputs(np.stack([_shrink(_read(path)) for path in training]), SHIPPED_SHA256, TRAINED_ON)
    write_inputs(SHIPPED.with_name(NAME), inputs)
    print(f"{len(training)} training images, limit {inputs.limit:.2f}")
    rng, every = np.random.default_rng(0), list[Bool]()
    for source in HELD_OUT:
        images = [_shrink(_vary(_read(path), rng)) for path in _render(folder, "held", source) for _ in range(2)]
        every.append(_show(f"held out: {source[0]}, seed {source[1]}", inputs, images))
    print(f"held out, all: {np.concatenate(every).mean():.1%} of {sum(map(len, every))} unfamiliar")
    root = Path(os.environ.get("MIRROR_REAL_DATA", "../shared/data"))
    for pattern in REAL:
        images = [_shrink(image) for path in sorted(root.glob(pattern)) for image in _read_all(path)]
        if images:
            _show(pattern, inputs, images)


def _show(name: str, inputs: FamiliarInputs, images: Sequence[UInt8]) -> Bool:
    unfamiliar = inputs.are_unfamiliar(np.stack(images))
    print(f"{name}: {unfamiliar.mean():.1%} of {len(images)} unfamiliar")
    return unfamiliar


def _render(folder: Path, group: str, source: tuple[str, int, int, int, int]) -> Iterator[Path]:
    """Render images of some drives of a preset, unless they exist."""
    preset, seed, traversals, every, first = source
    folder.mkdir(parents=True, exist_ok=True)
    for number, drive in enumerate(make_drives(preset, seed, None, traversals)[1]):
        if number % every != first:
            continue
        rng = np.random.default_rng([seed, number])
        for place in range(_INSTANTS):
            share = rng.uniform(0.1, 0.9)
            for camera in rng.choice(list(drive.vehicle.cameras), _CAMERAS, replace=False).tolist():
                path = folder / f"{group}_{preset}_{seed}_{number}_{place}_{camera}.png"
                if not path.is_file():
                    stamp = drive.condition.start_ns + int(share * drive.truth.duration_s * 1e6) * 1000
                    cv2.imwrite(str(path), drive.render(camera, stamp).bgr)
                yield path
        drive.forget()


def _read(path: Path) -> UInt8:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), np.uint8)


def _read_all(path: Path) -> Iterator[UInt8]:
    """An image, or every eighth frame of a video."""
    if path.suffix != ".mp4":
        yield _read(path)
        return
    video, number = cv2.VideoCapture(str(path)), 0
    while (found := video.read())[0]:
        if number % _EVERY_FRAME == 0:
            yield np.asarray(found[1], np.uint8)
        number += 1


def _vary(bgr: UInt8, rng: np.random.Generator) -> UInt8:
    """Another size and JPEG quality."""
    scale = float(rng.choice([1.0, 0.7]))
    small = cv2.resize(bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, int(rng.choice(_QUALITIES))])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)


def _shrink(bgr: UInt8) -> UInt8:
    """RGB pixels in the size of the network's images, as `hybridworldsim.petr.tiny.samples` makes them."""
    size = NetworkSettings().width_px, NetworkSettings().height_px
    interpolation = cv2.INTER_AREA if bgr.shape[1] > size[0] else cv2.INTER_LINEAR
    return np.ascontiguousarray(cv2.resize(bgr, size, interpolation=interpolation)[..., ::-1], np.uint8)
