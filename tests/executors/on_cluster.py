"""Work on a Ray cluster of several nodes of this machine, as a program: Ray does not share a process with other tests.

``python -m tests.executors.on_cluster FOLDER`` finds a fleet in ``FOLDER/fleet``, and a dataset to annotate in
``FOLDER/annotated``, and prints JSON: what `tests/executors/test_ray.py` compares.
"""

from __future__ import annotations

import json
import os
import sys
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
from tests.executors.ray_clusters import open_cluster

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
        try:
            ExecutorChoice("ray", resources={"GPU": 1.0}).open()
        except MirrorError as error:
            said["refused"] = str(error)
    said["cpu_s"] = sum(os.times()[:4])
    print(json.dumps(said))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
