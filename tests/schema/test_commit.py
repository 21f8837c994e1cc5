"""Names that get their bytes once: one winner of many writers, and errors that name both of two contents."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mirror.schema.commit import ConflictError, commit_bytes, commit_file, commit_folder
from mirror.schema.files import temporary_path

COMMITTERS, ROUNDS = 16, 20


def test_one_of_sixteen_committers_of_a_name_wins_and_the_others_name_both(tmp_path: Path) -> None:
    for number in range(ROUNDS):
        path, start = tmp_path / f"key{number}", threading.Barrier(COMMITTERS)
        won: list[int] = []
        said: dict[int, str] = {}

        def commit(writer: int, path: Path, start: threading.Barrier, won: list[int], said: dict[int, str]) -> None:
            start.wait()
            try:
                assert commit_bytes(path, f"of writer {writer}".encode())
                won.append(writer)
            except ConflictError as error:
                said[writer] = str(error)

        threads = [
            threading.Thread(target=commit, args=(writer, path, start, won, said)) for writer in range(COMMITTERS)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        (winner,) = won
        assert path.read_text() == f"of writer {winner}"
        assert len(said) == COMMITTERS - 1
        theirs = hashlib.sha256(path.read_bytes()).hexdigest()
        for writer, text in said.items():
            assert theirs in text and hashlib.sha256(f"of writer {writer}".encode()).hexdigest() in text
    assert len(list(tmp_path.iterdir())) == ROUNDS


def test_equal_bytes_are_done_by_all(tmp_path: Path) -> None:
    made = [commit_bytes(tmp_path / "deep" / "key", b"equal") for _ in range(3)]
    assert made == [True, False, False]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["key"]


def test_processes_are_as_threads(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from mirror.schema.commit import commit_bytes\n"
        "sys.stdin.readline()\n"
        "try: commit_bytes(Path(sys.argv[1]), sys.argv[2].encode()); print('won')\n"
        "except Exception as error: print(type(error).__name__)"
    )
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code, tmp_path / "key", str(number)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(2)
    ]
    said = sorted(one.communicate("go\n", timeout=60)[0].strip() for one in running)
    assert said == ["ConflictError", "won"]


def test_a_folder_is_complete_with_its_last_file_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, folder = tmp_path / "work", tmp_path / "there"
    for name in ("manifest.json", "z.parquet", "images/a.jpg"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(name)
    order: list[str] = []
    link = os.link

    def seen(one: Path, other: Path) -> None:
        order.append(Path(other).relative_to(folder).as_posix())
        link(one, other)

    monkeypatch.setattr(os, "link", seen)
    commit_folder(source, folder, "manifest.json")
    assert sorted(order[:-1]) == ["images/a.jpg", "z.parquet"] and order[-1] == "manifest.json"
    commit_folder(source, folder, "manifest.json")
    (source / "z.parquet").unlink()
    (source / "z.parquet").write_text("other")
    with pytest.raises(ConflictError, match=r"z\.parquet"):
        commit_folder(source, folder, "manifest.json")
    assert (folder / "z.parquet").read_text() == "z.parquet"


@pytest.mark.parametrize("error", [1, 95, 18])
def test_a_disk_without_hard_links_gets_a_copy_that_is_created_exclusively(
    error: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def refused(one: Path, other: Path) -> None:
        raise OSError(error, "no links here")

    monkeypatch.setattr(os, "link", refused)
    source = tmp_path / "made"
    source.write_bytes(b"made")
    assert commit_file(source, tmp_path / "key") and not commit_file(source, tmp_path / "key")
    source.write_bytes(b"else")
    with pytest.raises(ConflictError):
        commit_file(source, tmp_path / "key")
    assert (tmp_path / "key").read_bytes() == b"made"


def test_names_of_unfinished_files_are_of_one_attempt(tmp_path: Path) -> None:
    names = {temporary_path(tmp_path / "key").name for _ in range(100)}
    assert len(names) == 100
    assert all(name.startswith(".key.") and f"-{os.getpid()}-" in name for name in names)
