"""``mirror demo``."""

from __future__ import annotations

import math
import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode

_FLOOR: Final = "nearest_frame"
_BASELINES: Final = (_FLOOR, "mean_color")
_OTHER_FLOORS: Final = ("smoothed_nearest_frame", "grey_frame", "camera_mean", "mean_color")
"""Floors that are scored on the block alone, which has fewer views than the street."""
_ON_CPU: Final = ("--device", "cpu")
"""The demo computes the same everywhere."""
_IN_THIS_PROCESS: Final = ("--workers", "1")
"""Options of scoring: a process of its own imports for longer than the scores of a block take."""
_OURS: Final = "reconstructed"
_ANNOTATED: Final = "guangzhou-urban-01"
_MARK = ".made-by-mirror-demo"
_NOTE = "`mirror demo` may remove this folder and make it again.\n"
_EXAMPLES = ("mirror demo", "mirror demo --quick --seed 1 --out quick")


@dataclass(frozen=True)
class Arguments:
    """Run the verbs on a synthetic street: recordings, dataset, split, report, baselines, reconstruction, leaderboard.

    Two baselines are scored on the held-out traversals and enter a leaderboard. The calibration of one drive with
    nearer images is checked. One block of another street is reconstructed and ranked beside the five floors. The exit
    code is 1 if the reconstruction does not score above the nearest recorded images. Each command is printed before it
    runs. A second run replaces the folder.
    """

    out: Path = Path("demo")
    """A new folder, or the folder of an earlier demo, which is replaced."""
    quick: bool = False
    """One small scene instead of two, one baseline, no check of a calibration and no reconstruction."""
    seed: int = 0
    """Seed of the street and of the split."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror demo", examples=_EXAMPLES)

    begin = time.monotonic()
    _clear(arguments.out)
    for words in _commands(arguments):
        print(f"\n$ {_typed(words)}", flush=True)
        # A shell would expand the pattern.
        code = run([str(path) for word in words for path in (_matching(word) if "*" in word else [word])])
        if code not in _expected_codes(words):
            print(f"mirror demo: `{' '.join(words[:3])}` ended with {code}", file=sys.stderr)
            return code
    out = arguments.out
    print(
        f"\nDone in {time.monotonic() - begin:.0f} s: {out / 'dataset'} is a dataset, {out / 'report.html'} its report,"
    )
    print(f"{out / 'results'} has the scores of the baselines, {out / 'site' / 'index.html'} the leaderboard.")
    if _has_calibration(arguments):
        print(f"{out / 'calibration' / 'online' / 'report.html'} shows how far the cameras of one drive are off,")
        print(f"{out / 'calibration' / 'factory' / 'report.html'} the errors that their factory calibrations have.")
    if _has_reconstruction(arguments):
        print(f"{out / 'boxes.html'} shows the road users that a network found in one drive.")
        if _has_drive(arguments):
            print(f"{out / 'block' / 'drive' / 'report.html'} shows a drive through a reconstructed block,")
            print(f"{out / 'suite' / 'results' / 'report.html'} the twenty drives of a suite,")
        print(f"{out / 'block' / 'model'} is a reconstructed block, {out / 'block' / 'results'} has its scores:")
        return _compare_block(out / "block" / "results")
    if not arguments.quick:
        from mirror.installation import install_command

        print(f"Nothing was reconstructed: torch is not installed ({install_command('models')}).")
    return ExitCode.DONE


def _compare_block(results: Path) -> ExitCode:
    """Print the scores of the block and of the nearest images on the held-out traversal. The block must be above."""
    scores = {name: _held_out_scores(results / name) for name in (_OURS, _FLOOR)}
    for name, values in scores.items():
        structure, invariant = values["matched_structure"], values["psnr_invariant"]
        print(f"  {name:<13} structure {structure:.3f}, invariant PSNR {invariant:.2f} dB on the held-out traversal")
    if costs := _costs(results / _OURS):
        print(f"  {costs}")
    is_above = all(scores[_OURS][metric] > value for metric, value in scores[_FLOOR].items())
    return ExitCode.DONE if is_above else ExitCode.FINDINGS


def _costs(result: Path) -> str:
    """Speed and size of the block beside those of the paper; empty if they were not measured."""
    import numpy as np
    import pyarrow.parquet

    from mirror.evaluation.result import IMAGES, RESULT, Result
    from mirror.schema.files import read_json

    runtime = read_json(result / RESULT, Result).submission.runtime
    if runtime is None or None in (runtime.frames_per_second, runtime.model_bytes, runtime.driven_m):
        return ""
    pixels = np.mean(pyarrow.parquet.read_table(result / IMAGES, columns=["pixels"]).column("pixels").to_numpy())
    megabytes = 1e-6 * (runtime.model_bytes or 0) * 100.0 / (runtime.driven_m or math.nan)
    speed = f"{runtime.frames_per_second:.0f} images of {round(pixels, -2):,.0f} pixels per second"
    return f"{speed}, {megabytes:.1f} MB for 100 m of road (the paper: 21 of {960 * 540:,}, 400 MB)"


def _held_out_scores(result: Path) -> dict[str, float]:
    """Structure, which ranks, and invariant PSNR in dB on the held-out traversal; NaN if there is no value."""
    from mirror.evaluation.result import RESULT, Result
    from mirror.schema.files import read_json

    figures = read_json(result / RESULT, Result).figures
    values = {figure.metric: figure.value for figure in figures if (figure.group, figure.level) == ("novel", "group")}
    # NaN is above no value.
    shown = ("matched_structure", "psnr_invariant")
    return {metric: math.nan if (value := values[metric]) is None else value for metric in shown}


def run(words: Sequence[str]) -> int:
    """Run ``mirror VERB ...`` in this process, and return its exit code."""
    from mirror.cli.main import main as mirror

    return mirror(words[1:])


def _commands(arguments: Arguments) -> Iterator[list[str]]:
    out = arguments.out
    recordings, dataset, seed = out / "recordings", str(out / "dataset"), str(arguments.seed)
    preset = "quick" if arguments.quick else "demo"
    rois = str(recordings / "rois.geojson")
    yield ["mirror", "synth", "--out", str(recordings), "--preset", preset, "--seed", seed]
    maps = ["--map", str(recordings / "maps")]
    yield ["mirror", "ingest", str(recordings / "*-*"), "--rois", rois, *maps, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "split", dataset, "novel", "--seed", seed]
    yield ["mirror", "stats", dataset]
    yield ["mirror", "check", dataset]
    yield ["mirror", "report", dataset, "--out", str(out / "report.html")]
    for method in _BASELINES[: 1 if arguments.quick else None]:
        submission, result = str(out / "submissions" / method), out / "results" / method
        yield ["mirror", "baseline", dataset, "--method", method, "--split", "novel", "--out", submission]
        beside = [] if method == _FLOOR else ["--baseline", str(out / "results" / _FLOOR)]
        page = ["--report", *beside, *_IN_THIS_PROCESS]
        yield ["mirror", "evaluate", dataset, submission, "--out", str(result), *page]
        yield _board(arguments, str(result), submission, dataset, f"demo street ({preset}, seed {seed})")
    if _has_calibration(arguments):
        yield from _calibration(arguments)
    if _has_reconstruction(arguments):
        yield from _annotation(arguments, rois)
        yield from _block(arguments)
    if _has_drive(arguments):
        yield from _suite(arguments)
    yield ["mirror", "leaderboard", "build", "--board", str(out / "board"), "--unsigned", "--out", str(out / "site")]


def _expected_codes(words: Sequence[str]) -> tuple[ExitCode, ...]:
    """The exit codes with which the demo goes on: the factory calibrations of the street have errors to be found."""
    return (ExitCode.DONE, ExitCode.FINDINGS) if "--stage" in words else (ExitCode.DONE,)


def _board(arguments: Arguments, result: str, submission: str, dataset: str, street: str) -> list[str]:
    """The command that adds a result to the demo's board."""
    more = ["--submission", submission, "--board", str(arguments.out / "board"), *_IN_THIS_PROCESS]
    return ["mirror", "leaderboard", "add", str(Path(result) / "result.json"), dataset, "--dataset-name", street, *more]


def _has_reconstruction(arguments: Arguments) -> bool:
    return not arguments.quick and find_spec("torch") is not None


def _has_drive(arguments: Arguments) -> bool:
    needed = ("gymnasium", "scipy", "av")
    return _has_reconstruction(arguments) and all(find_spec(package) is not None for package in needed)


def _has_calibration(arguments: Arguments) -> bool:
    return not arguments.quick and find_spec("scipy") is not None


def _calibration(arguments: Arguments) -> Iterator[list[str]]:
    """The commands that check the calibration of one drive, which has images as near as tracking needs them."""
    out = arguments.out / "calibration"
    recordings, dataset = out / "recordings", str(out / "dataset")
    rois = str(recordings / "rois.geojson")
    yield ["mirror", "synth", "--out", str(recordings), "--preset", "calibration", "--seed", str(arguments.seed)]
    yield ["mirror", "ingest", str(recordings / "*-*"), "--rois", rois, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "calibrate", "check", dataset, "--out", str(out / "online")]
    yield ["mirror", "calibrate", "check", dataset, "--stage", "factory", "--out", str(out / "factory")]


def _annotation(arguments: Arguments, rois: str) -> Iterator[list[str]]:
    """The commands that find the road users of one drive, in a dataset of its own, beside the exact boxes."""
    from mirror.version import __version__

    dataset, drive = str(arguments.out / "annotated"), str(arguments.out / "recordings" / _ANNOTATED)
    yield ["mirror", "ingest", drive, "--rois", rois, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "annotate", dataset, "--annotator", "petr-tiny", "--version", "1", *_ON_CPU]
    page = ["--boxes", "petr-tiny@1", "--against", f"synth@{__version__}", "--out", str(arguments.out / "boxes.html")]
    yield ["mirror", "annotate", "report", dataset, *page]


def _block(arguments: Arguments) -> Iterator[list[str]]:
    """The commands that reconstruct one block of another street, compare it with recorded images, and drive in it."""
    out, seed = arguments.out / "block", str(arguments.seed)
    recordings, dataset, model = out / "recordings", str(out / "dataset"), str(out / "model")
    rois = str(recordings / "rois.geojson")
    yield ["mirror", "synth", "--out", str(recordings), "--preset", "block", "--seed", seed]
    maps = ["--map", str(recordings / "maps")]
    yield ["mirror", "ingest", str(recordings / "*-*"), "--rois", rois, *maps, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "split", dataset, "novel", "--seed", seed]
    budget = ["--minutes", "1.5", "--width", "160", "--initialise", "plane-sweep"]
    yield ["mirror", "reconstruct", dataset, "--split", "novel", *budget, *_ON_CPU, "--out", model]
    floors = (_FLOOR, *_OTHER_FLOORS)
    submissions = {name: str(out / "submissions" / name) for name in (_OURS, *floors)}
    results = {name: str(out / "results" / name) for name in submissions}
    yield ["mirror", "render", dataset, model, "--split", "novel", *_ON_CPU, "--out", submissions[_OURS]]
    for floor in floors:
        yield ["mirror", "baseline", dataset, "--method", floor, "--split", "novel", "--out", submissions[floor]]
    page = ["--report", *(word for floor in floors for word in ("--baseline", results[floor]))]
    for name in (*floors, _OURS):
        more = page if name == _OURS else []
        yield ["mirror", "evaluate", dataset, submissions[name], "--out", results[name], *more, *_IN_THIS_PROCESS]
        yield _board(arguments, results[name], submissions[name], dataset, f"demo block (seed {seed})")
    yield ["mirror", "compare", *(str(Path(results[name]) / "result.json") for name in (_OURS, _FLOOR))]
    if _has_drive(arguments):
        drive = ["--scenario", "hard-brake", "--policy", "idm", "--duration", "10", "--cameras", "front_wide,rear"]
        yield ["mirror", "simulate", dataset, model, *drive, "--report", *_ON_CPU, "--out", str(out / "drive")]


def _suite(arguments: Arguments) -> Iterator[list[str]]:
    """The commands that drive a policy through the short suite, score it, and put it on the board."""
    out, name = arguments.out / "suite", "closed-loop-mini"
    runs, results, board = str(out / "runs"), out / "results", str(arguments.out / "board")
    yield ["mirror", "simulate", "--suite", name, "--policy", "idm", "--out", runs]
    yield ["mirror", "evaluate", runs, "--protocol", name, "--report", "--out", str(results)]
    row = ["--again", "--dataset-name", "practice suite", "--board", board]
    yield ["mirror", "leaderboard", "add", str(results / "result.json"), runs, *row]


def _typed(words: Sequence[str]) -> str:
    return " ".join(word if "*" in word else shlex.quote(word) for word in words)


def _matching(pattern: str) -> list[Path]:
    folder = Path(pattern).parent
    return sorted(folder.glob(Path(pattern).name))


def _clear(out: Path) -> None:
    """Create the folder, or empty the folder of an earlier demo.

    Raises:
        UsageError: the folder has other contents.
    """
    from mirror.schema.folders import FolderKind, require_output_folder

    if require_output_folder(out, FolderKind.DEMO) is not None:
        print(f"{out}: removing the files of an earlier demo", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    # Written first and kept, so that the folder of an interrupted demo is recognised.
    (out / _MARK).write_text(_NOTE)
    for path in out.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != _MARK:
            path.unlink()
