"""``mirror demo``."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mirror.errors import ExitCode, UsageError

_MARK = ".made-by-mirror-demo"
_NOTE = "`mirror demo` may remove this folder and make it anew.\n"


@dataclass(frozen=True)
class Arguments:
    """Make recordings of a synthetic street, then run the verbs that turn them into a dataset, a split and a report.

    Every command is shown as it would be typed. Run again, it makes its own folder anew.
    """

    out: Path = Path("demo")
    """A new folder, or one that an earlier demo made."""
    quick: bool = False
    """One small scene instead of two."""
    seed: int = 0
    """Of the street and of the split."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="mirror demo")

    from mirror.cli.main import main as mirror

    begin = time.monotonic()
    _clear(arguments.out)
    for words in _commands(arguments):
        print(f"\n$ mirror {_typed(words)}", flush=True)
        # What a shell does with the pattern.
        opened = [str(path) for word in words for path in (_matching(word) if "*" in word else [word])]
        code = mirror(opened)
        if code != ExitCode.DONE:
            print(f"mirror demo: `mirror {words[0]}` ended with {code}", file=sys.stderr)
            return code
    report = arguments.out / "report.html"
    print(f"\nDone in {time.monotonic() - begin:.0f} s: {arguments.out / 'dataset'} is a dataset, {report} its report.")
    return ExitCode.DONE


def _commands(arguments: Arguments) -> Iterator[list[str]]:
    recordings, dataset = arguments.out / "recordings", str(arguments.out / "dataset")
    seed = str(arguments.seed)
    preset = "quick" if arguments.quick else "demo"
    yield ["synth", "--out", str(recordings), "--preset", preset, "--seed", seed]
    yield [
        "ingest",
        str(recordings / "*-*"),
        "--rois",
        str(recordings / "rois.geojson"),
        "--out",
        dataset,
        "--licence",
        "CC0-1.0",
    ]
    yield ["split", dataset, "novel", "--seed", seed]
    yield ["stats", dataset]
    yield ["check", dataset]
    yield ["report", dataset, "--out", str(arguments.out / "report.html")]


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
    if out.exists() and not (out / _MARK).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError("not an empty folder, and no demo made it", file=out, remedy="name another one with --out")
    if out.exists():
        shutil.rmtree(out)
    out.mkdir(parents=True)
    (out / _MARK).write_text(_NOTE)
