"""Images into a traversal's folder: the same bytes, by link or copy, whole or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from mirror.errors import DatasetError, RecordingError
from mirror.ingest.images import PlacedImages, place_images
from mirror.recordings.protocol import FileStream

HEADER = bytes.fromhex("ffd8 ffc0 0011 08 0438 0780 03 012200 021101 031101 ffda 000c 03 0100 0211 0311 003f00")
WAYS: list[tuple[Literal["link", "copy"], bool]] = [("link", False), ("link", True), ("copy", False), ("copy", True)]


def image(number: int) -> bytes:
    """A JPEG whose structure is whole: no byte of its image data is 0xFF."""
    return HEADER + np.random.default_rng(number).integers(0, 255, 100 + number, np.uint8).tobytes() + b"\xff\xd9"


@pytest.fixture
def stream(tmp_path: Path) -> FileStream:
    paths = []
    for number in range(40):
        paths.append(tmp_path / "raw" / f"{number}.jpg")
        paths[-1].parent.mkdir(exist_ok=True)
        paths[-1].write_bytes(image(number))
    stamps = np.arange(40, dtype=np.int64) * 100
    return FileStream("front", "jpeg", stamps, stamps, tuple(paths))


def place(
    stream: FileStream,
    folder: Path,
    transfer: Literal["link", "copy"],
    hashing: bool,
    steps: list[int] | None = None,
) -> PlacedImages:
    selected = np.arange(3, 38)
    advance = (lambda _: None) if steps is None else steps.append
    return place_images(stream, selected, selected * 100, folder, transfer=transfer, hashing=hashing, advance=advance)


@pytest.mark.parametrize(("transfer", "hashing"), WAYS)
def test_every_way_gives_the_same_bytes(
    stream: FileStream, tmp_path: Path, transfer: Literal["link", "copy"], hashing: bool
) -> None:
    steps: list[int] = []
    placed = place(stream, tmp_path / "out", transfer, hashing, steps)
    assert sum(steps) == 35
    assert placed.names == [f"{number * 100}.jpg" for number in range(3, 38)]
    assert (set(placed.width_px), set(placed.height_px), placed.codec) == ({1920}, {1080}, "jpeg")
    assert placed.linked == (35 if transfer == "link" else 0)
    for number, name, size, digest in zip(range(3, 38), placed.names, placed.sizes, placed.sha256):
        data = (tmp_path / "out" / name).read_bytes()
        assert data == image(number)
        assert size == len(data)
        assert digest == (hashlib.sha256(data).digest() if hashing else None)
        assert (tmp_path / "out" / name).samefile(stream.paths[number]) == (transfer == "link")
    assert len(list((tmp_path / "out").iterdir())) == 35


@pytest.mark.parametrize(("transfer", "hashing"), WAYS)
def test_a_symbolic_link_is_followed_to_its_file(
    stream: FileStream, tmp_path: Path, transfer: Literal["link", "copy"], hashing: bool
) -> None:
    (stream.paths[5]).rename(tmp_path / "raw" / "kept.bin")
    stream.paths[5].symlink_to("kept.bin")
    place(stream, tmp_path / "out", transfer, hashing)
    there = tmp_path / "out" / "500.jpg"
    assert not there.is_symlink()
    assert there.read_bytes() == image(5)


@pytest.mark.parametrize(("transfer", "hashing"), WAYS)
def test_a_missing_image_is_named(
    stream: FileStream, tmp_path: Path, transfer: Literal["link", "copy"], hashing: bool
) -> None:
    stream.paths[20].unlink()
    with pytest.raises(RecordingError, match="missing") as error:
        place(stream, tmp_path / "out", transfer, hashing)
    assert error.value.file == str(stream.paths[20])


@pytest.mark.parametrize(("transfer", "hashing"), WAYS[1:])
@pytest.mark.parametrize("broken", [b"", image(20)[:-3], b"GIF89a"], ids=["empty", "truncated", "another kind"])
def test_an_image_that_is_read_must_be_whole(
    stream: FileStream, tmp_path: Path, transfer: Literal["link", "copy"], hashing: bool, broken: bytes
) -> None:
    stream.paths[20].write_bytes(broken)
    with pytest.raises(RecordingError, match=r"truncated|neither a JPEG nor a PNG") as error:
        place(stream, tmp_path / "out", transfer, hashing)
    assert error.value.file == str(stream.paths[20])


def test_a_folder_that_is_there_is_not_written_into(stream: FileStream, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(DatasetError, match="cannot be written"):
        place(stream, tmp_path / "out", "copy", True)


def test_no_descriptor_is_left_open(stream: FileStream, tmp_path: Path) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    place(stream, tmp_path / "a", "copy", True)
    stream.paths[20].unlink()
    with pytest.raises(RecordingError):
        place(stream, tmp_path / "b", "link", True)
    assert len(list(Path("/proc/self/fd").iterdir())) == before
