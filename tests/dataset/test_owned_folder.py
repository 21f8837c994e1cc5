"""Folders of processes: a live owner keeps its own, those of dead owners are left over."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from mirror.dataset import owned_folder
from mirror.dataset.owned_folder import LEFT_OVER_AGE_S, OwnedFolder, abandoned_folders
from tests.processes import NEVER_S, Running


def own_a_folder(parent: str) -> None:
    own = OwnedFolder(Path(parent), "run")
    print(own.path, flush=True)
    time.sleep(NEVER_S)


def test_a_dead_process_leaves_its_folder_to_the_next(tmp_path: Path) -> None:
    with Running(own_a_folder, tmp_path) as running:
        dead = running.stdout.readline().decode().strip()
        running.send(signal.SIGKILL)
        assert running.wait() == -signal.SIGKILL
    alive = OwnedFolder(tmp_path, "run")
    assert [str(path) for path in abandoned_folders(tmp_path, "run")] == [dead]
    assert alive.path.exists()


def test_only_folders_are_left_over(tmp_path: Path) -> None:
    own = OwnedFolder(tmp_path, "run")
    own.release()
    (tmp_path / f"{own.path.name}0").write_text("no folder")
    assert list(abandoned_folders(tmp_path, "run")) == [own.path]


def test_folders_of_other_machines_go_by_age(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run.0123456789ab.feedbeef"
    folder.mkdir()
    (folder / "image.jpg").write_text("")
    assert list(abandoned_folders(tmp_path, "run")) == []
    now = time.time()
    monkeypatch.setattr(owned_folder.time, "time", lambda: now + LEFT_OVER_AGE_S - 60)
    assert list(abandoned_folders(tmp_path, "run")) == []
    monkeypatch.setattr(owned_folder.time, "time", lambda: now + LEFT_OVER_AGE_S + 60)
    assert list(abandoned_folders(tmp_path, "run")) == [folder]
