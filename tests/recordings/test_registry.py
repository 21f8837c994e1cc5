"""Readers are loaded from entry points, and a path is opened by the reader that recognises it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from mirror.errors import RecordingError
from mirror.recordings import registry
from mirror.recordings.protocol import ENTRY_POINT_GROUP, Recording
from tests.builders.small_folder import write_recording
from tests.wheels import install_plugins


class OddReader:
    """Recognises the same paths as the folder reader."""

    name = "odd"
    expects = "a folder with odd things"

    def recognises(self, path: Path) -> bool:
        return (path / "recording.json").is_file()

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        raise RecordingError("odd")


def test_the_built_in_readers_are_installed() -> None:
    assert {"boreas", "comma2k19", "csv", "dgp", "folder"} <= set(registry.load_readers())


def test_path_is_opened_by_the_reader_that_recognises_it(tmp_path: Path) -> None:
    recording = registry.open_recording(write_recording(tmp_path / "drive"))
    assert recording.info.drive_id == "drive-1"
    assert isinstance(recording, Recording)


def test_another_package_adds_a_reader(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install_plugins(monkeypatch, tmp_path / "site", ENTRY_POINT_GROUP, ("odd", f"{__name__}:OddReader"))
    path = write_recording(tmp_path / "drive")
    with pytest.raises(RecordingError, match="folder and odd") as caught:
        registry.open_recording(path)
    assert "--reader folder" in str(caught.value)
    assert "a folder with odd things" in str(caught.value)
    with pytest.raises(RecordingError, match=r"^odd$"):
        registry.open_recording(path, "odd")
    assert registry.open_recording(path, "folder").info.drive_id == "drive-1"


def test_a_reader_declared_twice_by_one_package_counts_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    before = registry.load_readers()
    install_plugins(monkeypatch, tmp_path, ENTRY_POINT_GROUP, ("csv", registry.READERS.find("csv").value))
    assert list(registry.load_readers()) == list(before)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("folder", f"{__name__}:OddReader", "two readers are named 'folder'.*some_plugins 1.*uninstall one"),
        ("strange", f"{__name__}:OddReader", "not a reader named 'strange'"),
        ("strange", "pathlib:Path", "not a reader named 'strange'"),
        ("strange", "no.such.module:Reader", "some_plugins 1.*cannot be loaded.*ModuleNotFoundError"),
        ("strange", f"{__name__}:NoReader", "some_plugins 1.*cannot be loaded.*AttributeError"),
    ],
)
def test_bad_entry_points_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, value: str, problem: str
) -> None:
    install_plugins(monkeypatch, tmp_path, ENTRY_POINT_GROUP, (name, value))
    with pytest.raises(RecordingError, match=problem):
        registry.load_readers()
    # Another reader is not hurt.
    assert list(registry.load_readers("csv")) == ["csv"]


def test_unrecognised_path_lists_the_formats_in_a_short_message(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="the folder is empty"):
        registry.open_recording(tmp_path)
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(RecordingError, match="no reader recognises this path") as caught:
        registry.open_recording(tmp_path)
    for name in ("boreas, ", "csv, ", "folder", "--reader NAME"):
        assert name in str(caught.value)
    assert len(str(caught.value).split()) < 60
    # The reader that is named says what is missing.
    with pytest.raises(RecordingError, match=r"scene_\*\.json"):
        registry.open_recording(tmp_path, "dgp")


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no file or folder at this path"):
        registry.open_recording(tmp_path / "gone")


def test_unknown_reader_lists_the_installed_readers(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no reader 'rosbag'.*folder"):
        registry.open_recording(tmp_path, "rosbag")


def test_unknown_options_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"'folder' .*--tz"):
        registry.open_recording(write_recording(tmp_path / "drive"), options={"tz": "UTC"})
