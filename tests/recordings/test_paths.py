"""File names of a recording: names that lead out of it are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.errors import RecordingError
from mirror.recordings.paths import (
    list_files,
    list_folder,
    natural_key,
    require_files_inside,
    require_inside,
    to_identifier,
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret.png").write_bytes(b"secret")
    recording = tmp_path / "recording"
    (recording / "masks").mkdir(parents=True)
    (recording / "masks" / "front.png").write_bytes(b"mask")
    return recording


@pytest.mark.parametrize("name", ["masks/front.png", "masks//front.png", "./masks/front.png", "not there yet.png"])
def test_names_inside_the_recording_are_accepted(root: Path, name: str) -> None:
    assert require_inside(root, name, file=root, place="here") == root / name
    assert require_files_inside(root, [name], file=root) == [root / name]


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../outside/secret.png",
        "masks/../../outside/secret.png",
        "/etc/passwd",
        "//host/share",
        "C:/secret.png",
        "C:secret.png",
        "..\\outside\\secret.png",
        "masks\0/front.png",
    ],
)
def test_names_that_lead_out_are_refused(root: Path, name: str) -> None:
    with pytest.raises(RecordingError, match="leads out of the recording") as caught:
        require_inside(root, name, file=root / "recording.json", place="cameras.front.static_mask")
    assert caught.value.place == "cameras.front.static_mask"


@pytest.mark.parametrize("name", ["", "..", "../outside/secret.png", "masks/../../outside/secret.png", "/etc/passwd"])
def test_one_of_many_names_that_leads_out_is_refused(root: Path, name: str) -> None:
    with pytest.raises(RecordingError, match="leads out of the recording") as caught:
        require_files_inside(root, ["masks/front.png", name], file=root / "table.json")
    assert caught.value.place == name


def test_one_of_many_links_that_leads_out_is_refused(root: Path) -> None:
    (root / "masks" / "link.png").symlink_to(root.parent / "outside" / "secret.png")
    (root / "images").symlink_to(root.parent / "outside")
    for name in ("masks/link.png", "images/secret.png"):
        with pytest.raises(RecordingError, match="leads out of the recording"):
            require_files_inside(root, ["masks/front.png", name], file=root)


def test_links_that_lead_out_are_refused(root: Path) -> None:
    (root / "masks" / "link.png").symlink_to(root.parent / "outside" / "secret.png")
    (root / "away").symlink_to(root.parent / "outside")
    for attempt in (
        lambda: require_inside(root, "masks/link.png", file=root, place="here"),
        lambda: require_inside(root, "away/secret.png", file=root, place="here"),
        lambda: list_folder(root, root / "masks"),
        lambda: list_folder(root, root / "away"),
        lambda: list_files(root),
    ):
        with pytest.raises(RecordingError, match="leads out of the recording"):
            attempt()


def test_links_inside_the_recording_are_followed(root: Path) -> None:
    (root / "masks" / "same.png").symlink_to("front.png")
    (root / "again").symlink_to(root)
    (root / ".hidden").write_text("")
    assert set(list_folder(root, root / "masks")) == {"front.png", "same.png"}
    assert [name for name, _ in list_files(root)] == ["masks/front.png", "masks/same.png"]


def test_numbers_are_sorted_by_value() -> None:
    assert sorted(["10", "9", "part_2", "part_10", "part_1a"], key=natural_key) == [
        "9",
        "10",
        "part_1a",
        "part_2",
        "part_10",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("b0c9|2018-08-02--08", "b0c9_2018-08-02--08"), ("_drive 1", "drive_1"), ("x" * 200, "x" * 120)],
)
def test_identifiers(text: str, expected: str) -> None:
    assert to_identifier(text) == expected


def test_text_without_letters_and_digits_is_refused() -> None:
    with pytest.raises(RecordingError, match="no letter or digit"):
        to_identifier("|||")


def test_hidden_files_hide_no_other_file(root: Path) -> None:
    """A folder's entries come in no order, so that hidden files lie between others."""
    names = {f"{number}.png" for number in range(20)}
    for name in names:
        (root / "masks" / name).write_bytes(b"mask")
        (root / "masks" / f".{name}").write_bytes(b"hidden")
    assert set(list_folder(root, root / "masks")) == {*names, "front.png"}
