"""Ingest stopped at any instant, and disks that are full: what is there afterwards is whole."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.layout import Layout
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording
from tests.interruption import SIGNALS, interrupt, interrupt_before, kill_command_before
from tests.processes import Running

HOUR_NS = 3_600_000_000_000
DRIVES = 4
KILLS = (
    ("*", 1),
    ("*.jpg", 30),
    ("recorded/manifest.json", 2),
    ("killed/traversals/*", 3),
    ("killed/drives/*", 2),
    ("index/snapshots/*", 1),
)
SCENES = [SCENE, SCENE.model_copy(update={"scene_id": "wide", "radius_m": 80.0})]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fleet")
    for number in range(DRIVES):
        direction = 120.0 if number % 2 else -120.0
        write_recording(
            root,
            f"drive_{number}",
            start_ns=START_NS + number * HOUR_NS,
            from_m=direction,
            to_m=-direction,
            seed=number,
        )
    write_rois(root / "rois.geojson", SCENES)
    return root


@pytest.fixture(scope="module")
def whole(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of a run that nobody disturbs."""
    out = tmp_path_factory.mktemp("undisturbed") / "whole"
    ingest_recordings(sorted(fleet.glob("drive_*")), SCENES, out)
    return out


def words(fleet: Path, out: Path) -> list[str]:
    recordings = [str(path) for path in sorted(fleet.glob("drive_*"))]
    return ["ingest", *recordings, "--rois", str(fleet / "rois.geojson"), "--out", str(out), "--copy"]


def test_killed_at_each_kind_of_write_and_run_again_it_ends_with_the_same_bytes(
    fleet: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    # From the first file of a work folder to the last of the index; each run continues the one before.
    for pattern, count in KILLS:
        kill_command_before(pattern, count, [*words(fleet, out), "--workers", "1"])
    assert main(words(fleet, out)) == 0
    assert compact_tree(out) == tree(whole)


def _files(root: Path) -> int:
    return sum(len(names) for _, _, names in os.walk(root))


def run_on_a_full_disk(*words: str) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))
    # The signal that would end the process becomes the error that a full disk gives.
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    sys.exit(main(words))


def test_a_full_disk_is_an_error_with_a_remedy_and_the_next_run_goes_on(
    fleet: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "d"
    first = sorted(fleet.glob("drive_*"))[:1]
    ingest_recordings(first, SCENES, out)
    before = tree(out)
    with Running(run_on_a_full_disk, *words(fleet, out)) as running, running.reading() as said:
        error = said()[1]
        assert running.wait() == 2
    assert "cannot be written" in error
    assert "free space or choose another place with --out" in " ".join(error.split())
    kept = {name: digest for name, digest in tree(out).items() if name in before}
    assert kept == before
    assert main(words(fleet, out)) == 0
    assert len(Layout(out).drive_ids()) == DRIVES
    assert compact_tree(out) == tree(whole)


def test_an_unwritable_place_is_an_error(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("not a folder")
    assert main(words(fleet, tmp_path / "file" / "d")) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_ctrl_c_ends_it_at_once_and_the_same_command_goes_on(fleet: Path, whole: Path, tmp_path: Path) -> None:
    out, hits = tmp_path / "stopped", 0
    for share, (number, group) in zip((0.05, 0.4, 0.8), SIGNALS):
        files = int(share * _files(whole))
        ended = interrupt(words(fleet, out), 0.0, number, group=group, once=lambda files=files: _files(out) >= files)
        hits += ended.hit
        if ended.hit:
            ended.require_stopped()
        assert not (out / ".lock").exists()
    assert hits
    assert main(words(fleet, out)) == 0
    assert compact_tree(out) == tree(whole)


def test_a_proposal_of_regions_stops(fleet: Path) -> None:
    ended = interrupt(["rois", "propose", *sorted(fleet.glob("drive_*"))], 0.0)
    if ended.hit:
        ended.require_stopped()


def test_a_failed_ingest_leaves_nothing_at_all(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    words = ["ingest", str(tmp_path / "empty"), "--roi", "1,2", "--out"]
    assert main([*words, str(tmp_path / "a" / "b")]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty"]
    # Also where it ends at the first error, and in a folder that was there.
    (tmp_path / "there").mkdir()
    assert main([*words, str(tmp_path / "there"), "--fail-fast"]) == 2
    assert list((tmp_path / "there").iterdir()) == []


def test_a_folder_that_is_something_else_is_left_alone(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ingest_recordings(sorted(fleet.glob("drive_*"))[:1], SCENES, tmp_path / "dataset")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "main.tex").write_text("")
    before = tree(tmp_path), tree(fleet)
    outs = [fleet, fleet / "drive_0", fleet / "drive_3" / "new", tmp_path / "thesis", tmp_path / "dataset" / "deeper"]
    for out in outs:
        assert main(words(fleet, out)) == 2
        said = capsys.readouterr().err
        assert str(out) in said
        assert "--out" in said
    assert (tree(tmp_path), tree(fleet)) == before


def test_what_a_killed_run_made_of_other_bytes_is_made_again(fleet: Path, tmp_path: Path) -> None:
    """The files have equal sizes and times, as copies that keep times have."""
    drive = Path(shutil.copytree(fleet / "drive_0", tmp_path / "drive_0"))
    out = tmp_path / "out"
    with interrupt_before("out/traversals/*"):
        ingest_recordings([drive], SCENES, out, IngestOptions(write=WriteOptions(transfer="copy")))
    assert list((out / ".staging").glob("*/traversals/*/recorded/manifest.json"))
    images = sorted((drive / "images" / "rear").glob("*.jpg"))
    for image in images:
        status, data = image.stat(), bytearray(image.read_bytes())
        data[len(data) // 2] ^= 1
        image.write_bytes(data)
        os.utime(image, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert not ingest_recordings([drive], SCENES, out, IngestOptions(write=WriteOptions(transfer="copy"))).failures
    fresh = tmp_path / "fresh"
    ingest_recordings([drive], SCENES, fresh, IngestOptions(write=WriteOptions(transfer="copy")))
    assert compact_tree(out) == tree(fresh)
