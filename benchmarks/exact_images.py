"""Processor time of images of the exact street in the drives of a suite, beside an earlier checkout.

``python -m benchmarks exact_images [--drives N] [--against CHECKOUT]``. Drives of `closed-loop`, spread
evenly over one street, are driven by the lane keeper; each step renders one camera at 160x90, and in a second run at
240x135. Times are medians of the processor time of an image, in one thread. ``--against`` measures another checkout
image by image in turns with this one, so that other work on the machine slows both alike, and prints the median of the
ratios: the error is the number of drives whose images or masks differ in a byte, the bar is none.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from operator import truediv
from pathlib import Path
from typing import Final

from benchmarks.report import Peer, Row, report

_ROOT: Final = Path(__file__).parents[1]
_BARS: Final = {160: 14.0, 240: 28.0}
_WARM: Final = 2

# Renders an image at each line of its input, and prints the width and the processor seconds; at last the hashes of the
# drives' images and masks.
_MEASURE: Final = """
import hashlib, json, sys, time
from hybridworldsim.simulator.policies.references import LaneKeeping
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.simulation import start_simulation
from hybridworldsim.simulator.suite import open_suite_street, require_suite
from mirror.protocols.document import load_protocol
from mirror.protocols.suite import list_drives
count, warm = int(sys.argv[1]), int(sys.argv[2])
suite = require_suite(load_protocol("closed-loop"))
drives = [drive for drive in list_drives(suite) if drive.street == suite.streets[-1]]
hashes = {}
for width in map(int, sys.argv[3:]):
    for drive in drives[:: max(len(drives) // count, 1)][:count]:
        street = open_suite_street(drive.street)
        simulation = start_simulation(street, drive.scenario, ends_off_road=True)
        cameras = rig_cameras(street, suite.cameras, width)
        renderer, policy = RendererFactory(suite.renderer).make(simulation, cameras), LaneKeeping()
        policy.reset(simulation.observation_spec({}))
        found, ending = hashlib.sha256(), None
        while ending is None:
            sys.stdin.readline()
            begin = time.process_time()
            images = renderer.render(simulation.now, suite.cameras)
            seconds = time.process_time() - begin
            print(json.dumps([width, seconds if simulation.now.step >= warm else None]), flush=True)
            for array in (*images.values(), *renderer.agent_masks().values()):
                found.update(array.tobytes())
            ending = simulation.advance(policy.act(simulation.observe({}, privileged=True)))
        hashes[f"{width}/{drive.folder}"] = found.hexdigest()
print(json.dumps({"hashes": hashes}), flush=True)
"""


def main(argv: list[str]) -> int:
    """Run the benchmark; returns 1 if a byte differs or an image takes longer than its bar."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks exact_images", description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=6, help="number of drives")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turns with this one")
    chosen = parser.parse_args(argv)
    rows = _rows(chosen.drives, chosen.against)
    return report("exact_images", {"exact images": rows}, errors="drives that differ")


@dataclass(frozen=True)
class _Measured:
    """Processor seconds of the images of a checkout by width, in order, and the hash of each drive."""

    seconds: dict[int, list[float]]
    hashes: dict[str, str]


def _rows(drives: int, against: Path | None) -> Iterator[Row]:
    ours, *others = _measure([_ROOT] if against is None else [_ROOT, against.resolve()], drives)
    for width, bar in _BARS.items():
        peers: tuple[Peer, ...] = ()
        error = None
        for theirs in others:
            names = [name for name in ours.hashes if name.startswith(f"{width}/")]
            error = sum(ours.hashes[name] != theirs.hashes.get(name) for name in names)
            ratio = statistics.median(map(truediv, ours.seconds[width], theirs.seconds[width]))
            peers = (Peer(f"{against}, {ratio:.2f} of it", 1e3 * statistics.median(theirs.seconds[width])),)
        size = f"{width}x{width * 9 // 16}, {len(ours.seconds[width])} images"
        ms = 1e3 * statistics.median(ours.seconds[width])
        yield Row("exact image of a street", size, ms, error, peers, "drives", bar, 0.5 if others else None)


def _measure(checkouts: Sequence[Path], drives: int) -> list[_Measured]:
    """Render the images of each checkout, image by image in turns."""
    found = [_Measured({width: [] for width in _BARS}, {}) for _ in checkouts]
    with ExitStack() as stack:
        children = [stack.enter_context(_start(checkout, drives)) for checkout in checkouts]
        running = True
        while running:
            for child, measured in zip(children, found, strict=True):
                line = json.loads(_ask(child))
                if isinstance(line, dict):
                    measured.hashes.update(line["hashes"])
                    running = False
                elif line[1] is not None:
                    measured.seconds[line[0]].append(line[1])
    return found


def _start(checkout: Path, drives: int) -> subprocess.Popen[str]:
    paths = os.pathsep.join((str(checkout), str(checkout / "baselines")))
    return subprocess.Popen(
        [sys.executable, "-c", _MEASURE, str(drives), str(_WARM), *map(str, _BARS)], cwd=checkout,
        env=os.environ | {"PYTHONPATH": paths}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


def _ask(child: subprocess.Popen[str]) -> str:
    if child.stdin is None or child.stdout is None:
        raise RuntimeError("a process without pipes")
    # The last line is printed without being asked for.
    with suppress(BrokenPipeError):
        child.stdin.write("\n")
        child.stdin.flush()
    line = child.stdout.readline()
    if not line:
        raise RuntimeError(f"the process of a checkout ended with code {child.wait()}")
    return line
