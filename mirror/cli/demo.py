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
_OURS: Final = "reconstructed"
_MARK = ".made-by-mirror-demo"
_NOTE = "`mirror demo` may remove this folder and make it anew.\n"


@dataclass(frozen=True)
class Arguments:
    """Make recordings of a synthetic street, and run the verbs that turn them into a dataset, a split and a report.

    Then two baselines are scored on the traversals that were held out, and stand on a board beside the paper's tables;
    and one block of another street is reconstructed, and scored beside the pictures that were taken nearest: it exits
    with 1 where it is not above them.
    Every command is shown as it would be typed. Run again, it makes its own folder anew.
    """

    out: Path = Path("demo")
    """A new folder, or one that an earlier demo made."""
    quick: bool = False
    """One small scene instead of two, one baseline, nothing reconstructed."""
    seed: int = 0
    """Of the street and of the split."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror demo")

    begin = time.monotonic()
    _clear(arguments.out)
    for words in _commands(arguments):
        print(f"\n$ {_typed(words)}", flush=True)
        # What a shell does with the pattern.
        opened = [str(path) for word in words for path in (_matching(word) if "*" in word else [word])]
        code = run(opened)
        if code != ExitCode.DONE:
            print(f"mirror demo: `{' '.join(words[:3])}` ended with {code}", file=sys.stderr)
            return code
    out = arguments.out
    print(
        f"\nDone in {time.monotonic() - begin:.0f} s: {out / 'dataset'} is a dataset, {out / 'report.html'} its report,"
    )
    print(f"{out / 'results'} what the baselines score on it", end="")
    print(f", {out / 'site' / 'index.html'} the board.")
    if _reconstructs(arguments):
        print(f"{out / 'block' / 'model'} is a reconstructed block, {out / 'block' / 'results'} what it scores:")
        return _compared(out / "block" / "results")
    if not arguments.quick:
        from mirror.installation import install_command

        print(f"Nothing was reconstructed: torch is not installed ({install_command('models')}).")
    return ExitCode.DONE


def _compared(results: Path) -> ExitCode:
    """Tell what the block scores on the traversal that was held out, which is to be more than the nearest pictures."""
    scores = {name: _held_out(results / name) for name in (_OURS, _FLOOR)}
    for name, own in scores.items():
        print(f"  {name:<13} PSNR {own['psnr']:.2f} dB, PSNR* {own['psnr_cc']:.2f} dB on the held-out traversal")
    if costs := _costs(results / _OURS):
        print(f"  {costs}")
    ahead = all(scores[_OURS][metric] > least for metric, least in scores[_FLOOR].items())
    return ExitCode.DONE if ahead else ExitCode.FINDINGS


def _costs(result: Path) -> str:
    """What the block takes, beside what the paper says of its own; nothing, where that is not known."""
    import numpy as np
    import pyarrow.parquet

    from mirror.evaluation.result import IMAGES, RESULT, Result
    from mirror.schema.files import read_json

    runtime = read_json(result / RESULT, Result).submission.runtime
    if runtime is None or None in (runtime.frames_per_second, runtime.model_bytes, runtime.driven_m):
        return ""
    pixels = np.mean(pyarrow.parquet.read_table(result / IMAGES, columns=["pixels"]).column("pixels").to_numpy())
    megabytes = 1e-6 * (runtime.model_bytes or 0) * 100.0 / (runtime.driven_m or math.nan)
    speed = f"{runtime.frames_per_second:.0f} pictures of {round(pixels, -2):,.0f} pixels a second"
    return f"{speed}, {megabytes:.1f} MB for 100 m of road (the paper: 21 of {960 * 540:,}, 400 MB)"


def _held_out(result: Path) -> dict[str, float]:
    from mirror.evaluation.result import RESULT, Result
    from mirror.schema.files import read_json

    figures = read_json(result / RESULT, Result).figures
    own = {one.metric: one.value for one in figures if (one.group, one.level) == ("novel", "group")}
    # A figure that there is not is above nothing.
    return {metric: math.nan if (value := own[metric]) is None else value for metric in ("psnr", "psnr_cc")}


def run(words: Sequence[str]) -> int:
    """Run ``mirror VERB ...`` in this process."""
    from mirror.cli.main import main as mirror

    return mirror(words[1:])


def _commands(arguments: Arguments) -> Iterator[list[str]]:
    out = arguments.out
    recordings, dataset, seed = out / "recordings", str(out / "dataset"), str(arguments.seed)
    preset = "quick" if arguments.quick else "demo"
    rois = str(recordings / "rois.geojson")
    yield ["mirror", "synth", "--out", str(recordings), "--preset", preset, "--seed", seed]
    yield ["mirror", "ingest", str(recordings / "*-*"), "--rois", rois, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "split", dataset, "novel", "--seed", seed]
    yield ["mirror", "stats", dataset]
    yield ["mirror", "check", dataset]
    yield ["mirror", "report", dataset, "--out", str(out / "report.html")]
    for method in _BASELINES[: 1 if arguments.quick else None]:
        submission, result = str(out / "submissions" / method), out / "results" / method
        yield ["mirror", "baseline", method, dataset, "--split", "novel", "--out", submission]
        yield ["mirror", "evaluate", submission, "--truth", dataset, "--out", str(result), "--report"]
        yield _board(arguments, str(result), submission, dataset, f"demo street ({preset}, seed {seed})")
    if _reconstructs(arguments):
        yield from _block(arguments)
    yield ["mirror", "leaderboard", "build", "--board", str(out / "board"), "--out", str(out / "site")]


def _board(arguments: Arguments, result: str, submission: str, dataset: str, street: str) -> list[str]:
    """Put a result on the demo's own board."""
    shown = ["--submission", submission, "--truth", dataset, "--board", str(arguments.out / "board")]
    return ["mirror", "leaderboard", "add", str(Path(result) / "result.json"), "--dataset", street, *shown]


def _reconstructs(arguments: Arguments) -> bool:
    return not arguments.quick and find_spec("torch") is not None


def _block(arguments: Arguments) -> Iterator[list[str]]:
    """Reconstruct one block of another street, and hold it against the pictures that were taken nearest."""
    out, seed = arguments.out / "block", str(arguments.seed)
    recordings, dataset, model = out / "recordings", str(out / "dataset"), str(out / "model")
    rois = str(recordings / "rois.geojson")
    yield ["mirror", "synth", "--out", str(recordings), "--preset", "block", "--seed", seed]
    yield ["mirror", "ingest", str(recordings / "*-*"), "--rois", rois, "--out", dataset, "--licence", "CC0-1.0"]
    yield ["mirror", "split", dataset, "novel", "--seed", seed]
    begin = ["--minutes", "1.5", "--width", "160", "--initialise", "plane-sweep"]
    yield ["mirror", "reconstruct", dataset, "--split", "novel", *begin, "--out", model]
    ours, floor = str(out / "submissions" / _OURS), str(out / "submissions" / _FLOOR)
    yield ["mirror", "render", model, "--dataset", dataset, "--split", "novel", "--out", ours]
    yield ["mirror", "baseline", _FLOOR, dataset, "--split", "novel", "--out", floor]
    results = []
    for submission in (ours, floor):
        results.append(str(out / "results" / Path(submission).name))
        yield ["mirror", "evaluate", submission, "--truth", dataset, "--out", results[-1], "--report"]
        yield _board(arguments, results[-1], submission, dataset, f"demo block (seed {seed})")
    yield ["mirror", "compare", *(str(Path(result) / "result.json") for result in results)]


def _typed(words: Sequence[str]) -> str:
    return " ".join(word if "*" in word else shlex.quote(word) for word in words)


def _matching(pattern: str) -> list[Path]:
    folder = Path(pattern).parent
    return sorted(folder.glob(Path(pattern).name))


def _clear(out: Path) -> None:
    """Make the folder, or empty the one that an earlier demo made.

    Raises:
        UsageError: it holds something else.
    """
    from mirror.schema.folders import FolderKind, require_output_folder

    if require_output_folder(out, FolderKind.DEMO) is not None:
        print(f"{out}: what an earlier demo left there is removed", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    # First, and not removed in between: an interrupted demo is known as one.
    (out / _MARK).write_text(_NOTE)
    for path in out.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != _MARK:
            path.unlink()
