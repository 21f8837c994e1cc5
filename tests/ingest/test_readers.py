"""A dataset is read without a pause while a run replaces what is in it."""

from __future__ import annotations

import gc
import json
import multiprocessing
import pickle
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording

HOUR_NS = 3_600_000_000_000
DRIVES = 3

READER = """
import sys
from pathlib import Path
import mirror
root, stop = Path(sys.argv[1]), Path(sys.argv[2])
states, opened, views = set(), 0, []
while not stop.exists():
    dataset = mirror.open(root)
    views = [*views[-2:], dataset]
    opened += 1
    for view in views:
        # What the images table says of an image, and what the image shows, are of one state, in all drives.
        shades, sizes = set(), set()
        for drive in view.drives():
            frames = view.where(drive=drive).frames()
            for frame in (frames[0], frames[len(frames) // 2]):
                for image in frame.images.values():
                    shades.add(int(image.decode().mean()) // 50)
                    image.read(verify=True)
        sizes = {int(x) // 1000 for x in view.table("ego_poses", ["height_m"]).column(0).to_pylist()}
        if len(shades) != 1 or sizes != shades:
            print("mixed", shades, sizes, flush=True)
            sys.exit(5)
        states |= shades
    if opened == 1:
        print("ready", flush=True)
print(opened, sorted(states), flush=True)
"""


def shade(drive: Path, state: int) -> None:
    """Put a drive into a state: grey of its images, and height of its poses."""
    rows = (drive / "poses.csv").read_text().splitlines()
    height = f"{1000 * state + 500}.0"
    (drive / "poses.csv").write_text(
        "\n".join([rows[0], *(",".join([*row.split(",")[:3], height, row.split(",")[4]]) for row in rows[1:])]) + "\n"
    )
    image = cv2.imencode(".png", np.full((48, 64, 3), 50 * state + 25, np.uint8))[1].tobytes()
    for path in (drive / "images").rglob("*.*g"):
        path.unlink()
        path.with_suffix(".png").write_bytes(image)


@pytest.fixture
def fleet(tmp_path: Path) -> list[Path]:
    drives = [
        write_recording(tmp_path / "fleet", f"drive_{number}", start_ns=START_NS + number * HOUR_NS, seed=number)
        for number in range(DRIVES)
    ]
    for drive in drives:
        shade(drive, 1)
    return drives


def test_readers_neither_fail_nor_read_mixed_data_while_drives_are_replaced(fleet: list[Path], tmp_path: Path) -> None:
    out, stop = tmp_path / "d", tmp_path / "stop"
    assert not ingest_recordings(fleet, [SCENE], out).failures
    readers = [
        subprocess.Popen(
            [sys.executable, "-c", READER, str(out), str(stop)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    for reader in readers:
        assert reader.stdout is not None
        assert reader.stdout.readline() == "ready\n", reader.communicate()
    for state in (2, 3, 4, 2):
        for drive in fleet:
            shade(drive, state)
        assert not ingest_recordings(fleet, [SCENE], out, IngestOptions(replace=True)).failures
        time.sleep(0.3)
    stop.touch()
    for reader in readers:
        said, error = reader.communicate(timeout=60)
        assert reader.returncode == 0, said + error
        opened, states = said.strip().split(" ", 1)
        assert int(opened) > 4
        assert {2, 3, 4} <= set(json.loads(states))
    ingest_recordings(fleet, [SCENE], tmp_path / "fresh")
    # The readers have gone: the next run removes what they needed.
    ingest_recordings(fleet, [SCENE], out)
    assert compact_tree(out) == tree(tmp_path / "fresh")


def test_an_open_view_reads_what_it_was_opened_on(fleet: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    ingest_recordings(fleet, [SCENE], out)
    view = mirror.open(out)
    poses = view.table("ego_poses")
    images = [frame.images["front_wide"].decode().mean() for frame in view.frames()]
    untouched = mirror.open(out)
    for state in (2, 3):
        for drive in fleet:
            shade(drive, state)
        assert not ingest_recordings(fleet, [SCENE], out, IngestOptions(replace=True)).failures
    assert view.where(drive="drive_1").table("ego_poses").num_rows * DRIVES == poses.num_rows
    assert [frame.images["front_wide"].decode().mean() for frame in view.frames()] == images
    # Also where nothing was read before the replacement, and in another process.
    assert untouched.table("ego_poses").equals(poses)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_images, (pickle.dumps(untouched),)) == images
    assert {int(frame.images["front_wide"].decode().mean()) for frame in mirror.open(out).frames()} == {175}
    del view, untouched
    gc.collect()
    ingest_recordings(fleet, [SCENE], out)
    assert not (out / ".superseded").exists()


def _images(pickled: bytes) -> list[float]:
    return [frame.images["front_wide"].decode().mean() for frame in pickle.loads(pickled).frames()]


def test_a_replacement_that_fails_at_any_step_leaves_the_dataset_as_it_was(
    fleet: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "d"
    ingest_recordings(fleet, [SCENE], out)
    before = tree(out)
    for drive in fleet:
        shade(drive, 2)
    original = Path.rename
    for step in range(1, 40):
        left = [step]

        def rename(self: Path, target: Path, left: list[int] = left) -> Path:
            # Moves into the dataset and out of it; what undoes them goes through.
            if ".superseded" not in str(self):
                left[0] -= 1
                if not left[0]:
                    raise OSError(28, "No space left on device", str(self))
            return original(self, target)

        monkeypatch.setattr(Path, "rename", rename)
        try:
            ingest_recordings(fleet[:1], [SCENE], out, IngestOptions(replace=True))
        except DatasetError as error:
            assert "No space left" in str(error)
            monkeypatch.undo()
            assert Layout(out).drive_ids() == [drive.name for drive in fleet]
            assert not (out / ".lock").exists()
            if step < 4:
                assert {name: d for name, d in tree(out).items() if not name.startswith(".staging")} == before
        else:
            monkeypatch.undo()
            break
    assert step > 4
    ingest_recordings(fleet, [SCENE], out, IngestOptions(replace=True))
    ingest_recordings(fleet, [SCENE], tmp_path / "fresh")
    assert compact_tree(out) == tree(tmp_path / "fresh")


def test_a_dataset_is_opened_as_it_was_while_a_long_run_appends(fleet: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    ingest_recordings(fleet[:1], [SCENE], out)
    hold, held = threading.Event(), threading.Event()

    class Progress:
        def start(self, what: str, total: int) -> None: ...

        def expect(self, steps: int) -> None: ...

        def advance(self, steps: int) -> None:
            held.set()
            assert hold.wait(20)

    running = threading.Thread(target=ingest_recordings, args=(fleet, [SCENE], out, IngestOptions(), Progress()))
    running.start()
    assert held.wait(20)
    assert mirror.open(out).drives() == ["drive_0"]
    hold.set()
    running.join(60)
    assert mirror.open(out).drives() == [drive.name for drive in fleet]
    shutil.rmtree(out)
