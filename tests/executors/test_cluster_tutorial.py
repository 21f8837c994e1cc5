"""The tutorial from a laptop to a cluster: processes, Ray and a bucket of this machine make the same dataset."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import mirror
from mirror.synth import SynthReport
from tests.builders.s3 import moto_bucket
from tests.executors.ray_clusters import cluster_environment
from tests.tutorial_pages import follow

pytest.importorskip("ray", reason="needs ray, of the extra cluster")


def hash_images(address: str) -> list[bytes]:
    return sorted(mirror.open(address).table("images", ["sha256"]).column(0).to_pylist())


def test_all_ways_lead_to_one_dataset(
    tiny_recordings: SynthReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def copy_recordings() -> None:
        shutil.copytree(tiny_recordings.recordings[0].parent, "recordings")

    (tmp_path / "home").mkdir()
    for name, value in cluster_environment(tmp_path / "home").items():
        monkeypatch.setenv(name, value)
    with moto_bucket():
        printed = follow(
            "tutorials/cluster.md",
            shorter={},
            stand_ins={"synth": copy_recordings},
            # Ray leaves threads in a process.
            apart=["ray"],
            capsys=capsys,
        )
        # Its images lie in archives, so that their rows have other places; their bytes are the same.
        assert hash_images("s3://fleet/street") == hash_images("dataset")
    ways = [line for line in printed if "ingest recordings" in line]
    assert [word for line in ways for word in ("processes", "ray", "s3://fleet/street") if word in line.split()] == [
        "processes", "ray", "s3://fleet/street"
    ]  # fmt: skip
    part = mirror.open("part")
    assert part.count("images") == mirror.open("dataset").where(camera="front_wide").count("images") > 0
