"""``mirror compile``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

from mirror.command_line import help_text, parse_arguments
from mirror.devices import CPU
from mirror.errors import ExitCode, UsageError

_EXAMPLES: Final = ("mirror compile", "mirror compile --cache /opt/mirror-kernels --json")
_VERBS: Final = "mirror"
_STEPS: Final = 20
"""Training images of the reconstruction: its functions are compiled at the first."""


@dataclass(frozen=True)
class Arguments:
    """Compile the kernels of the common verbs and keep the machine code, so that no later command waits for it.

    The verbs run on a tiny synthetic street in a temporary folder, which is removed; functions that they do not reach
    there are called with small inputs. What an extra needs that is not installed is left out. The machine code is for
    this processor and these versions of mirror and numba; where others are found, commands compile again by themselves.
    The exit code is 3 if a verb failed.
    """

    cache: Annotated[Path | None, help_text(default="beside the sources, or in the cache folder of the user")] = None
    """Folder that keeps the machine code, such as one of a container image or outside a home that cannot be written.
    Later commands use it where the environment variable NUMBA_CACHE_DIR names it and they may write there, as numba
    demands."""
    workers: int = 2
    """Number of processes. The second compiles traffic and safety while the first compiles the images."""
    json: bool = False
    """Print the result as JSON."""


@dataclass(frozen=True)
class CompiledStep:
    """One verb, or one module of calls with small inputs, that was run.

    Attributes:
        verb: its name.
        seconds: elapsed time.
        exit_code: its exit code.
    """

    verb: str
    seconds: float
    exit_code: int


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror compile", examples=_EXAMPLES)
    if arguments.workers < 1:
        raise UsageError(f"{arguments.workers} processes", place="--workers", expected="at least one process")
    cache = None if arguments.cache is None else _writable(arguments.cache)

    from mirror.pools import thread_pool

    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mirror-compile-") as folder, thread_pool(arguments.workers) as pool:
        chains = [pool.submit(_run_chain, chain, folder, cache) for chain in _chains(Path(folder))]
        steps = [step for chain in chains for step in chain.result()]
    failed = [step.verb for step in steps if step.exit_code]
    seconds = time.monotonic() - begin
    if arguments.json:
        kept = None if cache is None else str(cache)
        print(json.dumps({"cache": kept, "seconds": round(seconds, 1), "steps": [asdict(step) for step in steps]}))
    else:
        print(f"compiled the kernels of {', '.join(one.verb for one in steps if not one.exit_code)} in {seconds:.0f} s")
        if cache is not None:
            print(f"later commands use them with NUMBA_CACHE_DIR={cache}")
    return ExitCode.PARTLY_DONE if failed else ExitCode.DONE


def _writable(cache: Path) -> Path:
    """The folder, made if it is new.

    Raises:
        UsageError: nothing can be written there.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache):
            return cache.resolve()
    except OSError as error:
        raise UsageError(
            error.strerror or str(error), file=cache, place="--cache", expected="a folder that can be written",
            remedy="choose another folder with --cache",
        ) from error  # fmt: skip


def _chains(folder: Path) -> Iterator[list[list[str]]]:
    """Modules and their arguments that follow each other, for processes that work side by side; the longest first."""
    recordings, dataset = folder / "recordings", str(folder / "dataset")
    regions = ["--rois", str(recordings / "rois.geojson"), "--map", str(recordings / "maps")]
    drives = [str(recordings / f"guangzhou-urban-0{number}") for number in (1, 2)]
    has_models = find_spec("torch") is not None and find_spec("scipy") is not None
    chain = [
        ["synth", "--preset", "tiny", "--workers", "1", "--out", str(recordings)],
        ["ingest", *drives, *regions, "--licence", "CC0-1.0", "--out", dataset],
    ]
    if has_models:
        # On a GPU the kernels would not be called.
        training = ["--split", "novel", "--steps", str(_STEPS), "--device", CPU]
        chain += [
            ["split", dataset, "novel", "--train", "1", "--held-out-traversals", "1"],
            ["reconstruct", dataset, *training, "--out", str(folder / "model")],
            ["baseline", dataset, "--method", "nearest_frame", "--split", "novel", "--out", str(folder / "renders")],
            ["evaluate", dataset, str(folder / "renders"), "--workers", "1", "--out", str(folder / "results")],
        ]
    yield [[_VERBS, *words] for words in chain]
    beside = [["mirror.cli.small_inputs"]]
    if has_models:
        beside += [[module] for module in _small_inputs_of_methods()]
    if all(find_spec(package) is not None for package in ("gymnasium", "scipy")):
        drive = ["--scenario", "hard-brake", "--policy", "idm", "--duration", "1", "--renderer", "boxes", "--no-video"]
        beside += [[_VERBS, "simulate", "synth:tiny", *drive, "--out", str(folder / "drive")]]
    yield beside


def _small_inputs_of_methods() -> list[str]:
    """Return the modules ``small_inputs`` of the packages that have methods."""
    packages = {point.module.partition(".")[0] for point in entry_points(group="mirror.methods")}
    return [f"{name}.small_inputs" for name in sorted(packages) if find_spec(f"{name}.small_inputs") is not None]


def _run_chain(chain: Sequence[Sequence[str]], folder: str, cache: Path | None) -> list[CompiledStep]:
    done: list[CompiledStep] = []
    for words in chain:
        done.append(_run(words, folder, cache))
        if done[-1].exit_code:
            break
    return done


def _run(words: Sequence[str], folder: str, cache: Path | None) -> CompiledStep:
    from mirror.compiled import COMPILE_ALWAYS

    name = words[1] if words[0] == _VERBS else words[0]
    print(f"compiling the kernels of {name}", file=sys.stderr, flush=True)
    begin = time.monotonic()
    environment = os.environ | {COMPILE_ALWAYS: "1"}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    with Path(folder, f"{name}.log").open("w+") as log:
        ended = subprocess.run(
            [sys.executable, "-m", *words], env=environment, stdout=log, stderr=subprocess.STDOUT, check=False
        )
        log.seek(0)
        if ended.returncode:
            print(f"{name} ended with {ended.returncode}:\n{log.read()}", file=sys.stderr, flush=True)
    return CompiledStep(name, round(time.monotonic() - begin, 1), ended.returncode)
