"""Speed, error and memory of `mirror evaluate`, each run a process of its own with up to two workers.

``python -m benchmarks evaluate [--preset block]``. A street is made once in benchmarks/out/evaluate, and the nearest
training images are its renders, scored at 400 pixels. Processor time is that of user and system of all processes, the
start included; wall-clock time depends on what else the machine does. Errors are the largest differences of the table's
scores from plain float64 references; for SSIM that is scikit-image's map.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow.parquet as pq

from benchmarks.report import OUT, Row, report
from mirror.arrays import Bool, Float64, UInt8

_PLAIN: Final = ("psnr", "psnr_invariant", "psnr_affine", "ssim")
_WITH_PSNR_CC: Final = (*_PLAIN, "psnr_cc")
_MOST_MS: Final = 30.0
_CHECKED: Final = 12
"""Number of images whose scores are compared with references."""
_EVERY: Final = 3
_WORKERS: Final = 2
_PROTOCOL: Final = """
name = "evaluate-benchmark"
version = 1
task = "reconstruction"
description = "for the benchmark"
averaging = ["traversal", "scene"]
[[groups]]
name = "training"
roles = ["train"]
[[groups]]
name = "novel"
roles = ["held_out"]
[frames]
every = {every}
last = false
[pixels]
space = "undistorted"
max_width_px = 400
[masks]
ego = true
dynamic = ["masks", "boxes"]
{metrics}
"""
_METRICS: Final[Mapping[str, str]] = {"ssim": 'preset = "gaussian11"\nmask = "map"\n'}


# As in an installation: the modules are compiled to byte code once, not by every process.
_ENVIRONMENT: Final = {
    **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    "PYTHONPYCACHEPREFIX": str(OUT / "evaluate" / "bytecode"),
}


@dataclass(frozen=True)
class _Run:
    """One process: elapsed time, processor time of it and its workers, and the peak memory of the largest."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks evaluate", description=__doc__)
    parser.add_argument("--preset", default="block", help="preset of `mirror synth` (default: block)")
    arguments = parser.parse_args(argv)
    folder = OUT / "evaluate" / arguments.preset
    _prepare(folder, arguments.preset)
    return report("evaluate", {"mirror evaluate": _measure(folder)}, errors="error (dB, SSIM)")


def _prepare(folder: Path, preset: str) -> None:
    recordings, dataset = folder / "recordings", folder / "dataset"
    if not (recordings / "rois.geojson").is_file():
        _run("synth", "--preset", preset, "--out", str(recordings))
    if not (dataset / "index" / "snapshots").is_dir():
        rois = str(recordings / "rois.geojson")
        _run("ingest", str(recordings), "--rois", rois, "--licence", "CC0-1.0", "--out", str(dataset))
    if not (dataset / "splits" / "novel.json").is_file():
        _run("split", str(dataset), "novel")


def _measure(folder: Path) -> Iterator[Row]:
    for name, metrics, every in (
        ("PSNR, affine, invariant, SSIM", _PLAIN, _EVERY),
        ("the same of a quarter of the frames", _PLAIN, 4 * _EVERY),
        ("the same and PSNR*", _WITH_PSNR_CC, 4 * _EVERY),
    ):
        case = folder / f"{len(metrics)}-{every}"
        protocol, submission = _write_case(folder, case, metrics, every)
        results = case / "results"
        _remove(results)
        words = ["evaluate", str(folder / "dataset"), str(submission), "--protocol", str(protocol)]
        words += ["--out", str(results), "--workers", str(_WORKERS)]
        first = _run(*words)
        count = pq.read_metadata(results / "images.parquet").num_rows
        error = _largest_error(folder, protocol, submission, results) if every > _EVERY else None
        size = f"{count} images"
        bars = (_MOST_MS if every == _EVERY else None, None if error is None else 1e-9)
        yield Row(f"{name}: processor time", size, 1e3 * first.cpu_s / count, error, bar=bars[0], error_bar=bars[1])
        yield Row(f"{name}: wall-clock time", size, 1e3 * first.wall_s / count)
        second = _run(*words)
        yield Row("all scored already: processor time", size, 1e3 * second.cpu_s, bar=1e3)
        yield Row("all scored already: wall-clock time", size, 1e3 * second.wall_s)
        yield Row("peak memory of a process, MB", size, first.peak_mb)
        if every > _EVERY and metrics == _PLAIN:
            _remove(results)
            alone = _run(*words[:-1], "1")
            yield Row("one worker: processor time", size, 1e3 * alone.cpu_s / count)
            yield Row("one worker: wall-clock time", size, 1e3 * alone.wall_s / count)


def _write_case(folder: Path, case: Path, metrics: Sequence[str], every: int) -> tuple[Path, Path]:
    tables = "".join(f'[[metrics]]\nmetric = "{name}"\n{_METRICS.get(name, "")}' for name in metrics)
    protocol, submission = case / "protocol.toml", case / "submission"
    text = _PROTOCOL.format(every=every, metrics=tables)
    if not protocol.is_file() or protocol.read_text() != text:
        _remove(submission)
        case.mkdir(parents=True, exist_ok=True)
        protocol.write_text(text)
    if not (submission / "manifest.json").is_file():
        words = ("baseline", str(folder / "dataset"), "--method", "nearest_frame", "--split", "novel")
        _run(*words, "--protocol", str(protocol), "--out", str(submission))
    return protocol, submission


def _run(*words: str) -> _Run:
    """Run ``mirror WORDS`` in a process of its own.

    Raises:
        SystemExit: it failed.
    """
    code = "import sys; from mirror.cli.main import main; sys.exit(main(sys.argv[1:]))"
    begin = time.perf_counter()
    silent = os.open(os.devnull, os.O_WRONLY)
    files = [(os.POSIX_SPAWN_DUP2, silent, number) for number in (1, 2)]
    number = os.posix_spawn(sys.executable, [sys.executable, "-c", code, *words], _ENVIRONMENT, file_actions=files)
    _, status, usage = os.wait4(number, 0)
    os.close(silent)
    if status:
        raise SystemExit(f"`mirror {' '.join(words)}` ended with {os.waitstatus_to_exitcode(status)}")
    return _Run(time.perf_counter() - begin, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def _remove(folder: Path) -> None:
    import shutil

    if folder.exists():
        shutil.rmtree(folder)


def _largest_error(folder: Path, protocol_file: Path, submission: Path, results: Path) -> float:
    """The largest difference of scores of a few images from the references."""
    import mirror
    from mirror.protocols.document import load_protocol
    from mirror.protocols.png import decode_render
    from mirror.protocols.truth.source import GroundTruth
    from mirror.protocols.views import plan_views

    dataset, protocol = mirror.open(folder / "dataset"), load_protocol(str(protocol_file))
    plan = plan_views(dataset, protocol, "novel")
    truth = GroundTruth(dataset, protocol, plan.layers)
    rows = {row["path"]: row for row in pq.read_table(results / "images.parquet").to_pylist()}
    largest = 0.0
    for view in plan.views[:: max(len(plan.views) // _CHECKED, 1)]:
        render = decode_render((submission / view.path).read_bytes(), view.width_px, view.height_px, view.path)
        images = render, truth.image(view), truth.scored_mask(view)
        if images[2].sum() < 100:
            continue
        for metric, reference in _REFERENCES.items():
            largest = max(largest, abs(rows[view.path][metric] - reference(*images)))
    return largest


def _psnr(render: UInt8, truth: UInt8, mask: Bool) -> float:
    difference = (render[mask].astype(np.float64) - truth[mask]) / 255.0
    return float(-10.0 * np.log10(np.mean(difference**2)))


def _affine(render: UInt8, truth: UInt8, mask: Bool) -> float:
    """A gain, at least 0, and an offset for each channel, by `lstsq` over unsaturated pixels."""
    x, y = render[mask].astype(np.float64), truth[mask].astype(np.float64)
    errors = []
    for channel in range(3):
        a, b = x[:, channel], y[:, channel]
        usable = (a > 0) & (a < 255) & (b > 0) & (b < 255)
        gain, offset = np.linalg.lstsq(np.stack([a[usable], np.ones(usable.sum())], 1), b[usable], rcond=None)[0]
        if gain < 0:
            gain, offset = 0.0, b[usable].mean()
        errors.append(np.mean(((np.clip(gain * a + offset, 0, 255) - b) / 255.0) ** 2))
    return float(-10.0 * np.log10(np.mean(errors)))


def _invariant(render: UInt8, truth: UInt8, mask: Bool) -> float:
    """The determinant of what the best linear recolouring and two ramps leave, by `lstsq` on all pixels."""
    from mirror.metrics.images.pairs import ROUNDING_VARIANCE

    down, across = np.meshgrid(*(np.linspace(-0.5, 0.5, size) for size in mask.shape), indexing="ij")
    x, y = render[mask] / 255.0, truth[mask] / 255.0
    known = np.column_stack([x, across[mask], down[mask], np.ones(len(x))])
    left: Float64 = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
    values = np.linalg.eigvalsh(left.T @ left / len(left)) + ROUNDING_VARIANCE
    return float(-10.0 / 3.0 * np.sum(np.log10(values)))


def _ssim(render: UInt8, truth: UInt8, mask: Bool) -> float:
    from skimage.metrics import structural_similarity

    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": 2}
    _, found = structural_similarity(render, truth, data_range=255, full=True, **options)
    inside = mask.copy()
    inside[:5], inside[-5:], inside[:, :5], inside[:, -5:] = False, False, False, False
    return float(found[inside].mean())


_REFERENCES: Final[Mapping[str, Callable[[UInt8, UInt8, Bool], float]]] = {
    "psnr": _psnr,
    "psnr_affine": _affine,
    "psnr_invariant": _invariant,
    "ssim": _ssim,
}
