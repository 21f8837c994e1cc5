"""Several attempts at one thing: none deletes what another has finished, and the dead leave nothing for long."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, is_intact
from mirror.errors import DatasetError, RecordingError
from mirror.ingest import traversal as traversal_module
from mirror.ingest.images import place_images
from mirror.ingest.passes import DrivePasses
from mirror.ingest.run import ingest_recordings
from mirror.ingest.staging import Staging
from mirror.ingest.traversal import WriteOptions, WriteReport, write_traversal
from mirror.schema.tables import POINTS
from tests.builders.folder import SCENE, tree, write_recording
from tests.ingest.passes import passes_of_folder


@pytest.fixture
def drive(tmp_path: Path) -> DrivePasses:
    return passes_of_folder(write_recording(tmp_path / "fleet", "a"))


def attempt(staging: Staging, drive: DrivePasses) -> WriteReport:
    (number,) = drive.slices
    return write_traversal(staging, drive, number, SCENE, "0" * 64, WriteOptions(), 1, lambda steps: None)


@pytest.mark.parametrize("fails", [True, False])
def test_an_attempt_that_wakes_late_leaves_what_another_has_sealed(
    fails: bool, drive: DrivePasses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pauses in the middle of its images, B seals the traversal, A fails, or ends as well."""
    paused, go_on = threading.Event(), threading.Event()
    late = threading.local()

    def placing(stream, indices, stamps, folder, **more):  # type: ignore[no-untyped-def]
        placed = place_images(stream, indices, stamps, folder, **more)
        if folder.name == "front_wide" and threading.current_thread().name.startswith("late"):
            paused.set()
            assert go_on.wait(20)
            if fails:
                raise RecordingError("the disk of the recording went away", file=folder)
        return placed

    class NamedPool(traversal_module.ThreadPoolExecutor):
        def __init__(self, threads: int) -> None:
            super().__init__(threads, thread_name_prefix=threading.current_thread().name)

    monkeypatch.setattr(traversal_module, "place_images", placing)
    monkeypatch.setattr(traversal_module, "ThreadPoolExecutor", NamedPool)
    staging = Staging(Layout(tmp_path / "d"))

    def a() -> None:
        try:
            late.result = attempt(staging, drive)
            outcome.append("done")
        except RecordingError:
            outcome.append("failed")

    outcome: list[str] = []
    first = threading.Thread(target=a, name="late")
    first.start()
    assert paused.wait(20)
    written = attempt(staging, drive)
    sealed = staging.layout.recorded(written.traversal_id)
    assert is_intact(sealed)
    before = tree(sealed)
    go_on.set()
    first.join(20)
    assert outcome == ["failed" if fails else "done"]
    assert is_intact(sealed)
    assert tree(sealed) == before
    assert len(before) == written.images + 4
    # And neither left anything besides.
    assert {Path(path).parts[0] for path in tree(staging.layout.root)} == {"traversals"}


def test_a_run_that_wakes_late_leaves_what_another_run_has_published(drive: DrivePasses, tmp_path: Path) -> None:
    out = tmp_path / "d"
    late = Staging(Layout(out))
    attempt(late, drive)
    assert not ingest_recordings([drive.path], [SCENE], out).failures
    before = {name: digest for name, digest in tree(out).items() if not name.startswith(".staging")}
    late.forget("a")
    late.close(done=False)
    assert tree(out) == before


def test_what_a_killed_run_completed_is_taken_over_and_the_rest_removed(drive: DrivePasses, tmp_path: Path) -> None:
    out = tmp_path / "d"
    killed = Staging(Layout(out))
    name = attempt(killed, drive).traversal_id
    half = killed.layout.root / "attempts" / "x" / "traversals" / "half" / "recorded"
    half.mkdir(parents=True)
    (half / "ego_poses.parquet").write_text("half")
    inode = (killed.layout.recorded(name) / "manifest.json").stat().st_ino
    # Its owner lives: nobody touches it.
    other = Staging(Layout(out))
    assert (killed.layout.recorded(name) / "manifest.json").stat().st_ino == inode
    other.close(done=False)
    # As the system does for the dead.
    killed.own_folder.release()
    third = Staging(Layout(out))
    assert (third.layout.recorded(name) / "manifest.json").stat().st_ino == inode
    assert not killed.layout.root.exists()
    assert len(list((out / ".staging").iterdir())) == 1
    assert attempt(third, drive).reused


def test_a_layer_that_two_attempts_write_is_the_first_ones(drive: DrivePasses, tmp_path: Path) -> None:
    out = tmp_path / "d"
    name = ingest_recordings([drive.path], [SCENE], out).traversals[0].traversal_id
    late = LayerWriter(Layout(out), name, "points", "made", "1")
    late.file("late.bin", b"late")
    first = LayerWriter(Layout(out), name, "points", "made", "1")
    row = first.file("first.bin", b"first")
    first.finish(POINTS, [], {})
    folder = out / "traversals" / name / "layers" / "points" / "made@1"
    assert row["uri"] == str((folder / "first.bin").relative_to(out))
    before = tree(folder)
    assert sorted(before) == ["first.bin", "manifest.json", "points.parquet"]
    with pytest.raises(DatasetError, match="exists already"):
        late.finish(POINTS, [], {})
    assert tree(folder) == before
    del late
    with pytest.raises(DatasetError, match="exists already"):
        LayerWriter(Layout(out), name, "points", "made", "1")
    LayerWriter(Layout(out), name, "points", "made", "2").finish(POINTS, [], {})
    assert sorted(path.name for path in folder.parent.iterdir()) == ["made@1", "made@2"]
