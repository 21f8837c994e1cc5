"""Processor time of images of the exact street in the drives of a suite, beside an earlier checkout.

``python -m benchmarks exact_images [--drives N] [--repeats N] [--against CHECKOUT]``. Drives of `closed-loop`, spread
evenly over one street, are driven by the lane keeper; each step renders one camera at 160x90, and in a second run at
240x135. Times are medians of the processor time of an image, in one thread. ``--against`` measures another checkout in
turns with this one: the error is the number of drives whose images or masks differ in a byte, the bar is none.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from benchmarks.report import Peer, Row, report

_ROOT: Final = Path(__file__).parents[1]
_BARS: Final = {160: 14.0, 240: 28.0}
_WARM: Final = 2

# Prints the processor seconds of each image, and the hash of each drive's images and masks.
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
seconds, hashes = {}, {}
for width in map(int, sys.argv[3:]):
    seconds[width] = []
    for drive in drives[:: max(len(drives) // count, 1)][:count]:
        street = open_suite_street(drive.street)
        simulation = start_simulation(street, drive.scenario, ends_off_road=True)
        cameras = rig_cameras(street, suite.cameras, width)
        renderer, policy = RendererFactory(suite.renderer).make(simulation, cameras), LaneKeeping()
        policy.reset(simulation.observation_spec({}))
        found, ending = hashlib.sha256(), None
        while ending is None:
            begin = time.process_time()
            images = renderer.render(simulation.now, suite.cameras)
            if simulation.now.step >= warm:
                seconds[width].append(time.process_time() - begin)
            for array in (*images.values(), *renderer.agent_masks().values()):
                found.update(array.tobytes())
            ending = simulation.advance(policy.act(simulation.observe({}, privileged=True)))
        hashes[f"{width}/{drive.folder}"] = found.hexdigest()
print(json.dumps({"seconds": seconds, "hashes": hashes}))
"""


def main(argv: list[str]) -> int:
    """Run the benchmark; returns 1 if a byte differs or an image takes longer than its bar."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks exact_images", description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=6, help="number of drives")
    parser.add_argument("--repeats", type=int, default=1, help="runs, of which the least median counts")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turns with this one")
    chosen = parser.parse_args(argv)
    rows = _rows(chosen.drives, chosen.repeats, chosen.against)
    return report("exact_images", {"exact images": rows}, errors="drives that differ")


def _rows(drives: int, repeats: int, against: Path | None) -> Iterator[Row]:
    ours, theirs = [], []
    for _ in range(repeats):
        if against is not None:
            theirs.append(_measure(against.resolve(), drives))
        ours.append(_measure(_ROOT, drives))
    for width, bar in _BARS.items():
        ms, error = _median_ms(ours, width), None
        peers: tuple[Peer, ...] = ()
        if theirs:
            names = [name for name in ours[0]["hashes"] if name.startswith(f"{width}/")]
            error = sum(ours[0]["hashes"][name] != theirs[0]["hashes"].get(name) for name in names)
            peers = (Peer(str(against), _median_ms(theirs, width)),)
        size = f"{width}x{width * 9 // 16}, {len(ours[0]['seconds'][str(width)])} images"
        yield Row("exact image of a street", size, ms, error, peers, "drives", bar, 0.5 if theirs else None)


def _measure(checkout: Path, drives: int) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, str(drives), str(_WARM), *map(str, _BARS)], cwd=checkout, check=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join((str(checkout), str(checkout / "baselines")))},
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    measured: dict[str, Any] = json.loads(done.stdout)
    return measured


def _median_ms(runs: list[dict[str, Any]], width: int) -> float:
    return 1e3 * min(statistics.median(run["seconds"][str(width)]) for run in runs)
