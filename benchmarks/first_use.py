"""Processor time of the first uses of a fresh installation, with cold caches, and of the kernels that they compile.

``python -m benchmarks first_use [--repeats N] [--only STEP ...] [--against CHECKOUT] [--kernels N]``. Each step runs in
a new process whose cache of machine code is an empty folder, and once more with the cache that this filled. Figures are
medians of the processor time (user and system) of the process and its children; elapsed time depends on what else the
machine does. ``--against`` measures another checkout in turns with this one. The recordings are made once, in
benchmarks/out/first_use.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from benchmarks.report import OUT, Peer, Row, report

_ROOT: Final = Path(__file__).parents[1]
_RECORDINGS: Final = OUT / "first_use" / "recordings"
_DRIVES: Final = ("guangzhou-urban-01", "guangzhou-urban-02", "guangzhou-urban-03")

# Runs what follows it, and writes the processor seconds that each function took to compile, its callees not included.
_LISTEN: Final = """
import atexit, json, sys, threading, time
from numba.core import event
local, seconds, work = threading.local(), {}, sys.argv.pop(1)
class Listener(event.Listener):
    def on_start(self, compilation):
        local.open = [*getattr(local, "open", []), [time.thread_time(), 0.0]]
    def on_end(self, compilation):
        begin, inner = local.open.pop()
        took = time.thread_time() - begin
        if local.open:
            local.open[-1][1] += took
        function = compilation.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}"
        seconds[name] = seconds.get(name, 0.0) + took - inner
event.register("numba:compile", Listener())
out = sys.argv.pop(1)
atexit.register(lambda: json.dump(seconds, open(out, "w")))
exec(work)
"""
_VERB: Final = "from mirror.cli.main import main; code = main(sys.argv[1:]); assert code == 0, code"
_IMAGE: Final = """
import benchmarks.synth as bench
bench.render_view(next(bench.make_views(bench.build_city(), "day", "clear", 1, 960)))
"""
_RASTERIZED: Final = """
import torch
from benchmarks.rasterizer import scenes
from benchmarks.rasterizer.views import View
torch.set_num_threads(1)
view = View(scenes.random(100), 64, 48)
image, alphas, _ = view.render(view.tensors(gradients=True))
torch.autograd.backward([image, alphas], list(view.weights))
"""


@dataclass(frozen=True)
class _Step:
    work: str
    size: str
    bar: float
    words: tuple[str, ...] = ()


def _steps() -> dict[str, _Step]:
    drives = [str(_RECORDINGS / name) for name in _DRIVES]
    regions = ["--rois", str(_RECORDINGS / "rois.geojson"), "--map", str(_RECORDINGS / "maps")]
    ingest = ("ingest", *drives, *regions, "--licence", "CC0-1.0", "--out", "{out}")
    simulate = ("simulate", "synth:tiny", "--scenario", "hard-brake", "--policy", "idm", "--duration", "2")
    return {
        "ingest": _Step(_VERB, "3 drives", 4.0, ingest),
        "synth": _Step(_IMAGE, "a street and 960x540", 6.0),
        "rasterizer": _Step(_RASTERIZED, "100 64x48, gradients", 6.0),
        "simulate": _Step(_VERB, "2 s, 7 cameras, video", 8.0, (*simulate, "--out", "{out}")),
    }


@dataclass
class _Times:
    cold: list[float] = field(default_factory=list)
    cached: list[float] = field(default_factory=list)
    kernels: list[dict[str, float]] = field(default_factory=list)


def _measure(step: _Step, checkout: Path, times: _Times) -> None:
    with tempfile.TemporaryDirectory(prefix="first-use-") as folder:
        for found in (times.cold, times.cached):
            out = Path(folder, f"out{len(found)}{found is times.cold}")
            kernels = Path(folder, "kernels.json")
            words = [word.format(out=out) for word in step.words]
            environment = os.environ | {
                "NUMBA_CACHE_DIR": str(Path(folder, "cache")),
                "PYTHONPATH": os.pathsep.join((str(checkout), str(checkout / "baselines"))),
            }
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            done = subprocess.run(
                [sys.executable, "-c", _LISTEN, step.work, str(kernels), *words], cwd=checkout, env=environment,
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            if done.returncode:
                raise RuntimeError(done.stdout + done.stderr)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            found.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
            if found is times.cold:
                times.kernels.append(json.loads(kernels.read_text()))


def _rows(name: str, repeats: int, against: Path | None, shown: int) -> Iterator[Row]:
    step, ours, theirs = _steps()[name], _Times(), _Times()
    begin = time.perf_counter()
    for _ in range(repeats):
        if against is not None:
            _measure(step, against, theirs)
        _measure(step, _ROOT, ours)
    print(f"{name}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    for state, mine, other in (("cold", ours.cold, theirs.cold), ("cached", ours.cached, theirs.cached)):
        peers = (Peer(str(against), 1e3 * statistics.median(other)),) if other else ()
        bar = 1e3 * step.bar if state == "cold" else None
        yield Row(f"{name}, {state}", step.size, 1e3 * statistics.median(mine), peers=peers, bar=bar)
    total: Counter[str] = Counter()
    for kernels in ours.kernels:
        total.update({kernel: 1e3 * seconds / repeats for kernel, seconds in kernels.items()})
    yield Row(f"{name}, compilation", f"{len(total)} functions", total.total())
    for kernel, ms in total.most_common(shown):
        yield Row(f"  {kernel}", "", ms)


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks first_use", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="cold starts of which the median counts")
    parser.add_argument("--only", nargs="+", choices=list(_steps()), default=list(_steps()), help="what to measure")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turns with this one")
    parser.add_argument("--kernels", type=int, default=8, help="functions to list for a step, slowest first")
    chosen = parser.parse_args(argv)
    if not (_RECORDINGS / "synth.json").is_file():
        made = ["-m", "mirror", "synth", "--preset", "quick", "--out", str(_RECORDINGS)]
        subprocess.run([sys.executable, *made], check=True)
    rows = {name: _rows(name, chosen.repeats, chosen.against, chosen.kernels) for name in chosen.only}
    return report("first_use", rows)
