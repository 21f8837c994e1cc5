"""Measures executors: the same bytes from each, through SIGKILLs, poison drives and a lost node; what the engine costs.

``python -m benchmarks cluster [--drives 40] [--items 100000] [--only NAME]`` ingests a fleet of small drives in this
process, in processes, on Ray and on three Ray nodes, of which one is removed, with processes killed before and between
all puts, and with three poison drives; then it sends items through each executor. Each part runs in a process of its
own, because Ray does not share one, and prints rows of name, size, seconds and what was found.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from mirror.errors import DatasetError, ExitCode
from mirror.executors.choice import ExecutorChoice, Kind
from mirror.executors.executor import Executor
from mirror.executors.job import Failure, ParallelJob
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording
from tests.executors.ray_clusters import cluster_cpu_s, cluster_environment, open_cluster
from tests.ingest import hooks

PUTS: Final = (
    "recorded/front_wide/*.jpg",
    "recorded/rear/*.jpg",
    "recorded/calibrations.parquet",
    "recorded/ego_poses.parquet",
    "recorded/images.parquet",
    "recorded/manifest.json",
    "drives/*/drive.json",
    "drives/*/passes.parquet",
    "drives/*/manifest.json",
)
"""Names that a drive gets, by kind; before each of them processes are killed."""
POISON: Final = ("ValueError", "SIGSEGV", "endless")
LIMIT_S: Final = 60.0
_HOUR_NS: Final = 3_600_000_000_000
_ROOT: Final = Path(__file__).parents[1]


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="benchmarks cluster", description=__doc__)
    parser.add_argument("--drives", type=int, default=40)
    parser.add_argument("--items", type=int, default=100_000, help="for the memory of the driver")
    parser.add_argument("--only", choices=sorted(PARTS), action="append", help="run this part; may be repeated")
    parser.add_argument("--part", nargs=2, metavar=("NAME", "FOLDER"), help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.part is not None:
        PARTS[arguments.part[0]](Path(arguments.part[1]), arguments.items)
        return ExitCode.DONE
    code = ExitCode.DONE
    with tempfile.TemporaryDirectory() as folder:
        _write_fleet(Path(folder), arguments.drives)
        for name in arguments.only or PARTS:
            command = [sys.executable, "-m", "benchmarks", "cluster", "--items", str(arguments.items)]
            home = Path(folder) / "home"
            home.mkdir(exist_ok=True)
            environment = {**os.environ, **cluster_environment(home)}
            done = subprocess.run([*command, "--part", name, folder], cwd=_ROOT, env=environment, check=False)
            code = code if done.returncode == 0 else ExitCode.FINDINGS
    return code


def _write_fleet(folder: Path, count: int) -> None:
    write_rois(folder / "rois.geojson", [SCENE])
    for number in range(count):
        write_recording(
            folder / "fleet", f"drive_{number:03d}", start_ns=START_NS + number * _HOUR_NS, from_m=-90.0, to_m=90.0,
            seed=number,
        )  # fmt: skip
    start = time.perf_counter()
    ingest_recordings(_fleet(folder), [SCENE], folder / "serial", _options(None))
    _print("serial", count, time.perf_counter() - start, "")


def _fleet(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / "fleet").iterdir() if path.is_dir())


def _options(executor: ExecutorChoice | None) -> IngestOptions:
    reader = f"{Path(hooks.__file__).relative_to(_ROOT)}:HookedReader"
    write = WriteOptions(transfer="copy")
    return IngestOptions(reader=reader, workers=1, write=write, executor=executor, timeout_s=LIMIT_S)


def _ingest(name: str, folder: Path, executor: ExecutorChoice) -> None:
    """Ingest the fleet, and require the bytes of an ingest in one process."""
    start = time.perf_counter()
    fleet = _fleet(folder)
    report = ingest_recordings(fleet, [SCENE], folder / name, _options(executor))
    wall_s = time.perf_counter() - start
    difference = subprocess.run(
        ["diff", "-r", str(folder / "serial"), str(folder / name)], capture_output=True, text=True, check=False
    )
    _print(name, len(fleet), wall_s, "diff -r: " + (difference.stdout[:200] or "empty"))
    if report.failures or difference.returncode != 0:
        raise DatasetError(f"{name}: {report.failures}", file=folder / name)


def _processes(folder: Path, items: int) -> None:
    _ingest("processes", folder, ExecutorChoice("processes", 2))


def _ray(folder: Path, items: int) -> None:
    with open_cluster(folder / "home", {"num_cpus": 2}):
        _ingest("ray", folder, ExecutorChoice("ray"))


def _nodes(folder: Path, items: int) -> None:
    """Remove one of three nodes when a quarter of the drives is there."""
    with open_cluster(folder / "home", *[{"num_cpus": 1}] * 3) as cluster:
        drives = folder / "nodes" / "drives"

        def remove() -> None:
            while len(list(drives.glob("*/manifest.json"))) < len(_fleet(folder)) // 4:
                time.sleep(0.05)
            cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)

        threading.Thread(target=remove, daemon=True).start()
        _ingest("nodes", folder, ExecutorChoice("ray"))


def _kills(folder: Path, items: int) -> None:
    """Kill a process twice at every fourth drive, before another kind of name each time, on Ray."""
    for number, recording in enumerate(_fleet(folder)[::4]):
        patterns = {PUTS[number % len(PUTS)], PUTS[(number // 2 + 5) % len(PUTS)]}
        recording.with_name(f"{recording.name}.{hooks.KILL}").write_text(" ".join(patterns))
    with open_cluster(folder / "home", {"num_cpus": 2}):
        _ingest("kills", folder, ExecutorChoice("ray"))
    killed = list((folder / "fleet").glob("*.killed"))
    for file in [*killed, *(folder / "fleet").glob(f"*.{hooks.KILL}")]:
        file.unlink()
    _print("  SIGKILLs", len(killed), 0.0, f"before {len(PUTS)} kinds of names")


def _poison(folder: Path, items: int) -> None:
    """Ingest with three drives that fail, crash and never end."""
    fleet = _fleet(folder)
    ruined = dict(zip([fleet[5], fleet[17 % len(fleet)], fleet[-1]], POISON))
    for recording, ruin in ruined.items():
        recording.with_name(f"{recording.name}.{hooks.RUIN}").write_text(ruin)
    start = time.perf_counter()
    options = replace(_options(ExecutorChoice("processes", 2)), timeout_s=5.0)
    report = ingest_recordings(fleet, [SCENE], folder / "poison", options)
    found = {Path(one.recording).name: f"{one.status}, {one.attempts}" for one in report.dead_letters}
    _print("poison", len(fleet), time.perf_counter() - start, f"{len(report.drives)} done; {found}")
    for recording in ruined:
        recording.with_name(f"{recording.name}.{hooks.RUIN}").unlink()
    retried = replace(_options(ExecutorChoice("processes", 2)), retry_failed=True)
    ingest_recordings([], [SCENE], folder / "poison", retried)
    if (
        len(report.drives) != len(fleet) - len(POISON)
        or set(found) != {one.name for one in ruined}
        or (compact_tree(folder / "poison") != tree(folder / "serial"))
    ):
        raise DatasetError(f"poison: {found}", file=folder / "poison")


def _double() -> Callable[[int], int]:
    return lambda item: 2 * item


def _send(kind: Kind, executor: Executor, count: int) -> None:
    """Send items through an executor, and print processor time an item of this process, and how its memory grows."""

    def items() -> Iterator[int]:
        yield from range(count)

    job: ParallelJob[int, int] = ParallelJob(_double)
    warm = executor.map(job, range(200))
    for _ in warm:
        pass
    cpu_s, total, sizes_mb = time.process_time(), 0, []
    start = time.perf_counter()
    answers = executor.map(job, items())
    for done, (_, answer) in enumerate(answers):
        if isinstance(answer, Failure):
            answer.raise_error(kind, "none")
        total += answer
        if done % max(count // 10, 1) == 0:
            sizes_mb.append(_resident_mb())
    cpu_ms = 1e3 * (time.process_time() - cpu_s) / count
    grown_mb = max(sizes_mb[1:]) - sizes_mb[1]
    _print(
        f"engine {kind}", count, time.perf_counter() - start,
        f"{cpu_ms:.2f} CPU-ms an item in the driver; its memory: {sizes_mb[1]:.0f} MB, then {grown_mb:+.1f} MB",
    )  # fmt: skip
    if total != count * (count - 1):
        raise DatasetError(f"{kind}: a wrong sum")


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def _engine(folder: Path, items: int) -> None:
    with ExecutorChoice("processes", 2).open() as executor:
        _send("processes", executor, items)
    with open_cluster(folder / "home", {"num_cpus": 2}), ExecutorChoice("ray").open() as executor:
        before = cluster_cpu_s()
        _send("ray", executor, items)
        _print("  of which all", items, 0.0, f"{1e3 * (cluster_cpu_s() - before) / items:.2f} CPU-ms an item")


def _print(name: str, size: int, wall_s: float, found: str) -> None:
    print(f"{name:16} {size:>8} {wall_s:9.1f} s  {found}", flush=True)


PARTS: Final[dict[str, Callable[[Path, int], Any]]] = {
    "processes": _processes,
    "ray": _ray,
    "nodes": _nodes,
    "kills": _kills,
    "poison": _poison,
    "engine": _engine,
}
