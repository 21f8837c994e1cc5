"""Work on a Ray cluster of several nodes of this machine, as a program: Ray does not share a process with other tests.

``python -m tests.executors.on_cluster FOLDER`` finds a fleet in ``FOLDER/fleet``, and a dataset to annotate in
``FOLDER/annotated``, and prints JSON: what `tests/executors/test_ray.py` compares.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import mirror
from mirror.annotation.registry import AnnotatorChoice
from mirror.annotation.run import annotate
from mirror.errors import MirrorError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.privacy.run import deidentify
from tests.executors.ray_clusters import cluster_cpu_s, cluster_processes, open_cluster
from tests.privacy.conftest import options as marks_options

HOOKED = "tests/ingest/hooks.py:HookedReader"
WHERE = "tests/annotation/where.py:ANNOTATOR"


def main(folder: Path) -> None:
    """Work on a cluster of three nodes, and print what came of it."""
    said: dict[str, Any] = {}
    fleet = sorted(path for path in (folder / "fleet").iterdir() if path.is_dir())
    rois = read_rois(folder / "fleet" / "rois.geojson")
    nodes: list[dict[str, Any]] = [{"num_cpus": 1}, {"num_cpus": 1}, {"num_cpus": 1, "resources": {"model": 1}}]
    with open_cluster(folder / "home", *nodes):
        import ray

        options = IngestOptions(
            reader=HOOKED, write=WriteOptions(transfer="copy"), executor=ExecutorChoice("ray"), timeout_s=60.0
        )
        report = ingest_recordings(fleet, rois, folder / "ingested", options)
        said["dead_letters"] = [(Path(one.recording).name, one.status, one.attempts) for one in report.dead_letters]
        choice = AnnotatorChoice(WHERE, {"folder": str(folder / "where")}, "cpu")
        dataset = mirror.open(folder / "annotated")
        executor = ExecutorChoice("ray", resources={"model": 1.0})
        said["annotated"] = len(annotate(dataset, choice.open(dataset), executor=executor, choice=choice).written)
        said["model_nodes"] = [node["NodeID"] for node in ray.nodes() if "model" in node["Resources"]]
        marks = replace(marks_options(), executor=ExecutorChoice("ray"))
        said["deidentified"] = len(deidentify(folder / "faces", marks).written)
        said["listening"] = list_open_servers()
        said["cpu_s"] = cluster_cpu_s()
        try:
            ExecutorChoice("ray", resources={"GPU": 1.0}).open()
        except MirrorError as error:
            said["refused"] = str(error)
    print(json.dumps(said))


def list_open_servers() -> list[str]:
    """List the ports of the processes of this run that listen on more than the loopback address."""
    sockets = set()
    for process in cluster_processes():
        with suppress(OSError):
            for handle in (process / "fd").iterdir():
                with suppress(OSError):
                    sockets.add(str(handle.readlink()))
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for row in Path(table).read_text().splitlines()[1:]:
            fields = row.split()
            # 0A: it listens. The last four bytes of an address, in reverse order, end with 7F for 127.0.0.1.
            if (
                fields[3] == "0A"
                and f"socket:[{fields[9]}]" in sockets
                and not fields[1].split(":")[0].endswith("0100007F")
            ):
                found.append(fields[1])
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
