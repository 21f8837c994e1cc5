"""Takes a recorded rolling shutter through every verb: synth, ingest, split, reconstruct, render, evaluate.

A vehicle drives through the bend of the preset ``calibration`` once, by day. The same drive is recorded with a global
shutter, and with a readout of 30 ms; of that recording there is a copy whose calibrations state a global shutter, which
is what ignoring a readout is. Every fifth frame is held out of training and scored. All is done by the verbs that users
calls, in one process; a folder that is complete is kept, so that the same command continues.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks.report import OUT, Row
from mirror.cli.main import main
from mirror.synth import PRESETS, parse_readouts, write_recordings

PRESET: Final = "rolling-bend"
LOSS_BAR_DB: Final = 0.3
SPLIT: Final = "whole"
_PROTOCOL: Final = """
name = "rolling-bend"
version = 1
task = "reconstruction"
description = "Held-out frames of a drive through a bend, each row at its own time."
averaging = ["traversal", "scene"]
groups = [{ name = "training", roles = ["train"] }]
frames = { every = 5, last = false, first = 2, cameras = CAMERAS }
pixels = { space = "undistorted", widest_deg = 70.0, max_width_px = WIDTH, shutter = "SHUTTER" }
masks = { ego = true, dynamic = ["masks", "boxes"] }
ranking = { metric = "psnr", groups = ["training"] }
metrics = [{ metric = "psnr" }, { metric = "psnr_affine" }]
intervals = { level = 0.95, resamples = 100, block_frames = 5, seed = 0 }
"""


class Size(NamedTuple):
    """The size of a comparison.

    Attributes:
        width_px: width of the images.
        image_hz: images per second of each camera.
        steps: steps of a training.
        cameras: cameras with a rolling shutter, which are scored.
        initialise: how points of the street are estimated.
    """

    width_px: int
    image_hz: float
    steps: int
    cameras: tuple[str, ...] = ("front_wide",)
    initialise: str = "plane-sweep"


DECLARED: Final = Size(64, 1.0, 300)
QUICK: Final = Size(64, 1.0, 20)
WAYS: Final = ("global", "rolling, modelled", "rolling, ignored")


def recorded_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the PSNR of held-out frames for the three ways."""
    del repeats
    size = QUICK if quick else DECLARED
    folder = OUT / f"rolling-recorded-{size.width_px}-{size.image_hz:g}"
    psnr = {way: walk(folder, way, size)["psnr"] for way in WAYS}
    what = f"{size.width_px} px, {size.steps} steps"
    for way, value in psnr.items():
        yield Row(f"recorded bend, {way} (PSNR, dB)", what, value)
    yield Row(
        "recorded bend, loss by a shutter that is modelled (dB)", what, psnr[WAYS[0]] - psnr[WAYS[1]], bar=LOSS_BAR_DB
    )
    yield Row("recorded bend, loss by a shutter that is ignored (dB)", what, psnr[WAYS[0]] - psnr[WAYS[2]])


def walk(folder: Path, way: str, size: Size) -> dict[str, float]:
    """Take one way from the recording to its scores.

    Args:
        folder: working folder, which the ways share.
        way: one of `WAYS`.
        size: size of the comparison.

    Returns:
        Means of the metrics over the held-out frames.
    """
    dataset = prepare(folder, way, size)
    return train(dataset, dataset.parent / f"{size.steps}-steps", size)


def prepare(folder: Path, way: str, size: Size) -> Path:
    """Record a way, ingest it, and write its split; return the folder of the dataset."""
    own = folder / way.replace(", ", "-")
    dataset = own / "dataset"
    if not (dataset / "splits" / f"{SPLIT}.json").is_file():
        shutil.rmtree(own, ignore_errors=True)
        recordings = record(folder, own, way, size)
        call("ingest", recordings, "--rois", recordings / "rois.geojson", "--licence", "CC0-1.0", "--out", dataset)
        call("split", dataset, SPLIT, "--method", "by-scene", "--train", 1.0, "--val", 0.0, "--test", 0.0)
    return dataset


def train(dataset: Path, out: Path, size: Size) -> dict[str, float]:
    """Reconstruct a dataset into a folder, render the held-out frames, and return the means of their metrics."""
    model, submission, results = (out / name for name in ("model", "submission", "results"))
    protocol = write_protocol(out, size)
    words = ("--split", SPLIT, "--protocol", protocol)
    call(
        "reconstruct", dataset, *words, "--hold-out", "--steps", size.steps, "--width", size.width_px, "--threads", 1,
        "--initialise", size.initialise, "--out", model,
    )  # fmt: skip
    if not (submission / "manifest.json").is_file():
        call("render", dataset, model, *words, "--out", submission)
    call("evaluate", dataset, submission, "--protocol", protocol, "--out", results)
    result = json.loads((results / "result.json").read_text())
    return {one["metric"]: one["value"] for one in result["figures"] if one["level"] == "group"}


def write_protocol(folder: Path, size: Size, shutter: str = "calibrated") -> Path:
    """Write the protocol of a size, with or without the times of rows, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path, cameras = folder / f"{shutter}.toml", json.dumps(list(size.cameras))
    text = _PROTOCOL.replace("CAMERAS", cameras).replace("WIDTH", str(size.width_px)).replace("SHUTTER", shutter)
    path.write_text(text)
    return path


def record(folder: Path, own: Path, way: str, size: Size) -> Path:
    """Write the recordings of a way, and return their folder."""
    PRESETS[PRESET] = replace(PRESETS["calibration"], name=PRESET, width_px=size.width_px, image_hz=size.image_hz)
    rolling = way != WAYS[0]
    recordings = folder / ("rolling" if rolling else "global")
    readouts = parse_readouts(",".join(f"{name}=top_to_bottom:30" for name in size.cameras)) if rolling else ()
    write_recordings(recordings, PRESET, readouts=readouts, workers=1)
    if way != WAYS[2]:
        return recordings
    undeclared = own / "recordings"
    shutil.copytree(recordings, undeclared, dirs_exist_ok=True)
    for path in undeclared.glob("*/calibrations/*.json"):
        rows: list[dict[str, Any]] = json.loads(path.read_text())
        path.write_text(json.dumps([row | {"shutter_direction": "global", "readout_ns": 0} for row in rows]))
    return undeclared


def call(*words: object) -> dict[str, Any]:
    """Call a verb of `mirror`, and return what it says as JSON.

    Raises:
        RuntimeError: the verb ended with another exit code than 0.
    """
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main([*(str(word) for word in words), "--json"])
    if code != 0:
        raise RuntimeError(f"mirror {words[0]} ended with {code}: {said.getvalue()}")
    found: dict[str, Any] = json.loads(said.getvalue())
    return found
