"""Ray clusters for tests: of this machine alone, with a token, without a dashboard, outside of the home folder."""

from __future__ import annotations

import logging
import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mirror.executors.ray_cluster import PRIVATE


def cluster_environment(home: Path) -> dict[str, str]:
    """The environment of a process that begins a cluster, or that is the driver of one of its own."""
    return {
        **PRIVATE,
        "HOME": str(home),
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_memory_monitor_refresh_ms": "0",
        # Otherwise 15: on a busy machine a test would wait for minutes.
        "RAY_worker_niceness": "0",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]),
    }


@contextmanager
def open_cluster(home: Path, *nodes: dict[str, Any]) -> Iterator[Any]:
    """Begin a cluster of one node or more, and connect this process, which has not imported Ray yet.

    Args:
        home: takes the place of the home folder.
        nodes: arguments of `Cluster.add_node`; the first one is the head.
    """
    assert "ray" not in sys.modules
    os.environ.update(cluster_environment(home))
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster()
    try:
        for number, node in enumerate(nodes):
            head: dict[str, Any] = {"include_dashboard": False} if number == 0 else {}
            cluster.add_node(object_store_memory=100 << 20, wait=True, **head, **node)
        # It prints pages on standard output for each worker and node that ends.
        vars(ray._private.worker)["_worker_logs_enabled"] = False
        ray.init(address=cluster.address, log_to_driver=False, logging_level=logging.ERROR)
        yield cluster
    finally:
        ray.shutdown()
        cluster.shutdown()


def cluster_processes() -> list[Path]:
    """Folders in /proc of this process and of all below it: those of its cluster."""
    parents: dict[str, str] = {}
    for process in Path("/proc").glob("[0-9]*"):
        # A process may end while it is read.
        with suppress(OSError):
            parents[process.name] = _status(process)[1]
    mine = {str(os.getpid())}
    while more := {name for name, parent in parents.items() if parent in mine} - mine:
        mine |= more
    return [Path("/proc", name) for name in sorted(mine)]


def cluster_cpu_s() -> float:
    """Processor time of this process and its cluster, and of what of both has ended and was waited for."""
    ticks = 0
    for process in cluster_processes():
        with suppress(OSError):
            ticks += sum(map(int, _status(process)[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def _status(process: Path) -> list[str]:
    """The fields of a process's status after its name."""
    return (process / "stat").read_text().rpartition(")")[2].split()
