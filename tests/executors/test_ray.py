"""The Ray executor on three nodes of this machine: the bytes of one process, failures that stay alone, refusals.

One program has all that needs a cluster, which takes seconds to start. `python -m benchmarks cluster` has the rest: 40
drives, SIGKILLs before every put, a node that is removed, and what the engine costs.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import mirror
from mirror.annotation.run import annotate
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.privacy.run import deidentify
from tests.annotation.known import Known
from tests.builders.dataset import write_two_drives
from tests.builders.folder import SCENE, START_NS, tree, write_recording
from tests.executors.on_cluster import HOOKED
from tests.executors.ray_clusters import cluster_environment
from tests.ingest import hooks
from tests.privacy.conftest import install_marks, make_dataset, options

HOUR_NS = 3_600_000_000_000
ROOT = Path(__file__).parents[2]


def test_three_nodes_make_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "site").mkdir()
    install_marks(tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "site")
    for name in ("faces", "searched"):
        make_dataset(tmp_path / name)
    deidentify(tmp_path / "searched", options())
    fleet = tmp_path / "fleet"
    drives = [
        write_recording(fleet, f"drive_{number}", start_ns=START_NS + number * HOUR_NS, seed=number)
        for number in range(7)
    ]
    write_rois(fleet / "rois.geojson", [SCENE])
    ingest_recordings(
        drives[:6], [SCENE], tmp_path / "whole", IngestOptions(reader=HOOKED, write=WriteOptions(transfer="copy"))
    )
    (fleet / f"drive_6.{hooks.RUIN}").write_text("SIGSEGV")
    (fleet / f"drive_0.{hooks.KILL}").write_text("recorded/manifest.json")
    image = next((drives[0] / "images" / "rear").iterdir()).read_bytes()
    for name in ("annotated", "known"):
        write_two_drives(tmp_path / name, image)
    annotate(mirror.open(tmp_path / "known"), Known())
    (tmp_path / "where").mkdir()
    (tmp_path / "home").mkdir()
    environment = {**os.environ, **cluster_environment(tmp_path / "home")}
    environment["PYTHONPATH"] += f"{os.pathsep}{tmp_path / 'site'}"
    done = subprocess.run(
        [sys.executable, "-m", "tests.executors.on_cluster", str(tmp_path)], cwd=ROOT, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    # Ray says among it that a worker ended.
    said = json.loads(done.stdout.splitlines()[-1])
    print(f"{said['cpu_s']:.1f} CPU-s in the cluster")
    assert said["dead_letters"] == [["drive_6", "crashed", 3]]
    assert (fleet / "drive_0.0.killed").exists()
    ingested = {name: sha256 for name, sha256 in tree(tmp_path / "ingested").items() if "failures" not in name}
    assert ingested == tree(tmp_path / "whole")
    # The model runs where its resource was declared, and its layers have the same bytes.
    assert said["annotated"] == 2
    assert {file.read_text() for file in (tmp_path / "where").iterdir()} == set(said["model_nodes"])
    assert tree(tmp_path / "annotated") == tree(tmp_path / "known")
    assert said["deidentified"] == 2
    assert tree(tmp_path / "faces") == tree(tmp_path / "searched")
    assert "no node of the cluster has GPU=1" in said["refused"] and "--num-gpus" in said["refused"]
    assert said["listening"] == []
    assert not (tmp_path / "home" / ".ray").exists()


def test_what_keeps_a_cluster_away_is_named(tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{unused.getsockname()[1]}"
    drive = write_recording(tmp_path / "fleet", "drive_0")
    ingest = ["ingest", str(drive), "--roi", "11.5,48.1", "--out", str(tmp_path / "out"), "--executor", "ray"]
    said = _refused([*ingest, "--address", address])
    assert "nobody answers" in said and address in said and "ray start --head" in said
    assert "HOST:PORT" in _refused([*ingest, "--address", "somewhere"])
    assert "--resource" in _refused([*ingest, "--resource", "GPU=none"])
    hidden = tmp_path / "hidden" / "ray"
    hidden.mkdir(parents=True)
    (hidden / "__init__.py").write_text("raise ModuleNotFoundError(\"No module named 'ray'\", name='ray')\n")
    said = _refused(ingest, PYTHONPATH=str(hidden.parent))
    assert "the extra cluster" in said and "pip install" in said and "[cluster]" in said


def _refused(words: list[str], **environment: str) -> str:
    command = [sys.executable, "-m", "mirror", *words]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    return done.stderr
