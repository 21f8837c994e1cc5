"""Real streets: ours and its baselines on the recordings of a folder, every eighth frame held out, at equal cost.

``python -m benchmarks real --data DIR [--sequences NAME,...] [--methods NAME,...] [--minutes 2,10] [--rows]``.
Sequences that DIR lacks are skipped by name. Each row is one sequence, method and budget: training, renders and scores
of the held-out frames; a finished row is kept in OUT/rows.jsonl, so that a run continues. ``--rows`` prints the rows
and runs none.
Images of KITTI (CC BY-NC-SA) are for research and are never published: OUT stays outside of the repository's files.
"""

from __future__ import annotations

import csv
import json
import runpy
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro

from benchmarks.report import OUT
from mirror.arrays import Float64
from mirror.errors import ExitCode, UsageError

_ROOT: Final = Path(__file__).resolve().parents[1]
OURS: Final = ("hybridworldsim", "hybridworldsim_structure")
BASELINES: Final = ("mtgs_style", "vanilla_3dgs")
WITH_BOXES: Final = ("omnire_style",)
_KEYS: Final = ("psnr", "ssim", "st_lpips_alex")
_SECOND_NS: Final = 1_000_000_000
_SHORT: Final = ("--min-duration-s", "0.1", "--min-path-m", "1")
_PROTOCOL: Final = """name = "{name}"
version = 1
task = "reconstruction"
description = "Held-out frames of one drive; whole frames."
averaging = ["scene"]
groups = [{{ name = "held-out", roles = ["train"] }}]
frames = {{ {frames}, last = false }}
pixels = {{ space = "undistorted", max_width_px = {width} }}
masks = {{ ego = false, dynamic = [{dynamic}] }}
metrics = [{{ metric = "psnr" }}, {{ metric = "ssim", preset = "gaussian11", mask = "map" }}{more}]
"""
_PERCEPTUAL: Final = ', { metric = "lpips", net = "alex", mask = "zero-fill" }'


@dataclass(frozen=True)
class RealSequence:
    """A sequence of the folder.

    Attributes:
        name: folder in DIR.
        prepare: makes a dataset of it: folder of the source, working folder, dataset.
        frames: held-out frames, as in a protocol.
        width_px: width of trained and scored images.
        has_boxes: whether road users have boxes.
    """

    name: str
    prepare: Callable[[Path, Path, Path], None]
    frames: str = "first = 7, every = 8"
    width_px: int = 480
    has_boxes: bool = False


def _run(*words: object) -> None:
    """Run a verb; a failure ends the benchmark with the verb's own message."""
    from mirror.cli.main import main as verb

    code = verb([str(word) for word in words])
    if code not in (ExitCode.DONE, ExitCode.PARTLY_DONE):
        raise UsageError(f"`mirror {' '.join(map(str, words[:2]))}` ended with code {code}", expected="its result")


def _ingest(recording: Path, work: Path, dataset: Path) -> None:
    rois = work / "rois.geojson"
    _run("rois", "propose", recording, "--count", 1, "--min-traversals", 1, *_SHORT, "--out", rois)
    _run("ingest", recording, "--rois", rois, *_SHORT, "--copy", "--out", dataset)


def _prepare_plain(source: Path, work: Path, dataset: Path) -> None:
    _ingest(source, work, dataset)


def _prepare_images(source: Path, work: Path, dataset: Path) -> None:
    """Find the poses of images without any, at the camera's height of KITTI's station wagon; see `mirror poses`."""
    known = dict(line.split() for line in (source / "intrinsics.txt").read_text().splitlines())
    images = work / "images"
    images.mkdir(exist_ok=True)
    files = sorted(source.glob("*.jpg"))
    step_ns = round(_SECOND_NS / float(known["hz"]))
    with (work / "times.csv").open("w", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(("file", "timestamp_ns"))
        for number, file in enumerate(files):
            shutil.copyfile(file, images / file.name)
            writer.writerow((file.name, 1_317_000_000 * _SECOND_NS + number * step_ns))
    from mirror.geometry.cameras import Camera
    from mirror.recordings.lens_files import write_lens

    numbers = {key: float(value) for key, value in known.items()}
    lens = Camera(
        "pinhole", int(numbers["width"]), int(numbers["height"]), numbers["fx"], numbers["fy"], numbers["cx"] + 0.5,
        numbers["cy"] + 0.5,
    )  # fmt: skip
    write_lens(work / "lens.yaml", lens)
    words = ("--camera", f"front={images}", "--times", f"front={work / 'times.csv'}", "--drive-id", source.name)
    _run("recording", "new", *words, "--out", work / "recording")
    height = known["camera_height_m"]
    _run(
        "poses", work / "recording", "--lens", work / "lens.yaml", "--camera-height-m", height, "--out", work / "posed"
    )
    _ingest(work / "posed", work, dataset)


def _prepare_photos(source: Path, work: Path, dataset: Path) -> None:
    runpy.run_path(str(_ROOT / "examples" / "lund_recording.py"))["main"](source, work / "recording")
    _ingest(work / "recording", work, dataset)


SEQUENCES: Final = (
    RealSequence("kitti_odometry_a", _prepare_plain),
    RealSequence("kitti_raw_91", _prepare_images),
    RealSequence("dgp_scene_02", _prepare_plain, "first = 1, every = 3", 320, has_boxes=True),
    RealSequence("opensfm_lund", _prepare_photos, width_px=320),
)


@dataclass(frozen=True)
class RealArguments:
    """Train and score ours and its baselines on real recordings, at equal processor time."""

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder with the sequences."""
    sequences: str = ",".join(one.name for one in SEQUENCES)
    """Names of sequences, separated by commas."""
    methods: str = ",".join((*OURS, *BASELINES, *WITH_BOXES))
    """Names of methods; those that need boxes run where there are some."""
    minutes: str = "2,10"
    """Core-minutes of training of each block."""
    threads: int = 1
    """Number of threads of training."""
    out: Path = OUT / "real"
    """Working folder: datasets, models and rows.jsonl."""
    rows: bool = False
    """Print the finished rows and run none."""


def _protocol(sequence: RealSequence, work: Path) -> Path:
    """Write the protocol of a sequence; ST-LPIPS is scored where its weights are at hand."""
    from mirror.weights.errors import WeightsUnavailableError
    from mirror.weights.resolve import WeightResolver

    try:
        WeightResolver().resolve("st-lpips-alex")
        more = _PERCEPTUAL
    except WeightsUnavailableError:
        more = ""
    text = _PROTOCOL.format(
        name=f"real-{sequence.name.replace('_', '-')}", frames=sequence.frames, width=sequence.width_px,
        dynamic='"boxes"' if sequence.has_boxes else "", more=more,
    )  # fmt: skip
    (work / "protocol.toml").write_text(text)
    return work / "protocol.toml"


def run_row(
    sequence: RealSequence, source: Path, method: str, minutes: float, threads: int, out: Path
) -> dict[str, Any]:
    """Prepare, train, render and score one row.

    Args:
        sequence: the sequence.
        source: its folder.
        method: the method.
        minutes: core-minutes of training of each block.
        threads: number of threads of training.
        out: working folder.

    Returns:
        The row: names, mean figures, figures of each image by name, seconds and bytes.
    """
    import pyarrow.parquet as pq

    work = out / sequence.name
    work.mkdir(parents=True, exist_ok=True)
    dataset = work / "dataset"
    if not (work / "prepared").is_file():
        for old in ("dataset", "recording", "posed", "images"):
            shutil.rmtree(work / old, ignore_errors=True)
        sequence.prepare(source, work, dataset)
        _run("split", dataset, "one", "--method", "by-scene", "--train", 1, "--val", 0, "--test", 0)
        (work / "prepared").touch()
    protocol, own = _protocol(sequence, work), work / f"{method}-{minutes:g}"
    asked = ("--split", "one", "--protocol", protocol)
    start = time.process_time()
    begin = ("--hold-out", "--width", sequence.width_px, "--initialise", "plane-sweep", "--device", "cpu")
    _run("reconstruct", dataset, *asked, *begin, "--method", method, "--minutes", minutes, "--threads", threads,
         "--out", own / "model")  # fmt: skip
    spent = time.process_time() - start
    for part in ("submission", "scores"):
        shutil.rmtree(own / part, ignore_errors=True)
    _run("render", dataset, own / "model", *asked, "--out", own / "submission")
    # Without AlexNet's weights LPIPS is replaced by ST-LPIPS, under its own name.
    _run("evaluate", dataset, own / "submission", "--protocol", protocol, "--stand-ins", "--out", own / "scores")
    table = pq.read_table(own / "scores" / "images.parquet")
    images = {key: table[key].to_pylist() for key in _KEYS if key in table.column_names}
    size = sum(file.stat().st_size for file in (own / "model").rglob("*") if file.is_file())
    means = {key: float(np.mean(values)) for key, values in images.items()}
    return {
        "sequence": sequence.name, "method": method, "minutes": minutes, **means, "images": images,
        "seconds": round(spent, 1), "bytes": size,
    }  # fmt: skip


def paired_interval(differences: Float64, clusters: Float64, seed: int = 0) -> tuple[float, float, float]:
    """Return the mean of differences (N,) and its 95 % interval: a bootstrap over clusters (N,), 2000 draws."""
    names = np.unique(clusters)
    means = np.array([differences[clusters == name].mean() for name in names])
    draws = np.random.default_rng(seed).integers(0, len(means), (2000, len(means)))
    low, high = np.quantile(means[draws].mean(axis=1), (0.025, 0.975))
    return float(means.mean()), float(low), float(high)


def report_rows(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield lines: each row, the paired differences within each sequence, and those pooled over sequences."""
    yield "| sequence | core-minutes | method | PSNR | SSIM | ST-LPIPS | seconds | MB |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in rows:
        perceptual = f"{row['st_lpips_alex']:.3f}" if "st_lpips_alex" in row else "no weights"
        yield (
            f"| {row['sequence']} | {row['minutes']:g} | {row['method']} | {row['psnr']:.2f} | {row['ssim']:.3f} |"
            f" {perceptual} | {row['seconds']:.0f} | {row['bytes'] / 1e6:.1f} |"
        )
    by_key = {(row["sequence"], row["minutes"], row["method"]): np.array(row["images"]["psnr"]) for row in rows}
    for minutes in sorted({row["minutes"] for row in rows}):
        for one in OURS:
            for other in (*BASELINES, *WITH_BOXES):
                pairs = {
                    name: by_key[name, minutes, one] - by_key[name, minutes, other]
                    for name in dict.fromkeys(row["sequence"] for row in rows)
                    if (name, minutes, one) in by_key and (name, minutes, other) in by_key
                }
                for name, values in pairs.items():
                    mean, low, high = paired_interval(values, np.arange(len(values), dtype=np.float64))
                    yield (
                        f"{one} - {other}, {minutes:g} core-minutes, {name}: {mean:+.2f} dB ({low:+.2f} to {high:+.2f};"
                        f" {len(values)} images)"
                    )
                if len(pairs) > 1:
                    joined = np.concatenate(list(pairs.values()))
                    clusters = np.repeat(np.arange(len(pairs), dtype=np.float64), [len(one) for one in pairs.values()])
                    mean, low, high = paired_interval(joined, clusters)
                    yield (
                        f"{one} - {other}, {minutes:g} core-minutes, pooled over {len(pairs)} sequences:"
                        f" {mean:+.2f} dB ({low:+.2f} to {high:+.2f})"
                    )


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = tyro.cli(RealArguments, args=list(argv), prog="python -m benchmarks real")
    journal = arguments.out / "rows.jsonl"
    rows = [json.loads(line) for line in journal.read_text().splitlines()] if journal.is_file() else []
    if not arguments.rows:
        known = {one.name: one for one in SEQUENCES}
        wanted = arguments.sequences.split(",")
        unknown = [name for name in wanted if name not in known]
        if unknown:
            raise UsageError(f"no sequence {unknown[0]!r}", place="--sequences", expected=f"some of {', '.join(known)}")
        done = {(row["sequence"], row["method"], row["minutes"]) for row in rows}
        for name in wanted:
            source = arguments.data / name
            if not source.is_dir():
                print(f"{name}: skipped, there is no {source}")
                continue
            for minutes in map(float, arguments.minutes.split(",")):
                for method in arguments.methods.split(","):
                    needs_boxes = method in WITH_BOXES and not known[name].has_boxes
                    if (name, method, minutes) in done or needs_boxes:
                        continue
                    row = run_row(known[name], source, method, minutes, arguments.threads, arguments.out)
                    rows.append(row)
                    with journal.open("a") as file:
                        file.write(json.dumps(row) + "\n")
    for line in report_rows(rows):
        print(line)
    return ExitCode.DONE
