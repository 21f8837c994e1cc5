"""Untrusted folders, zips and JSON."""

from __future__ import annotations

import contextlib
import json
import os
import stat
import zipfile
from pathlib import Path

import pytest

from mirror.errors import UsageError
from mirror.evaluation.submission import untrusted
from mirror.evaluation.submission.untrusted import UntrustedError, open_untrusted, parse_untrusted


def test_links_pipes_and_deep_folders_are_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"secret")
    root = tmp_path / "submission"
    (root / "renders").mkdir(parents=True)
    (root / "renders" / "a.png").write_bytes(b"abc")
    (root / "renders" / "link.png").symlink_to(secret)
    (root / "folder").symlink_to(tmp_path)
    os.mkfifo(root / "pipe.png")
    deep = root
    for _ in range(20):
        deep = deep / "d"
        deep.mkdir()
    (deep / "far.png").write_bytes(b"far")
    files = open_untrusted(root)
    assert files.sizes == {"renders/a.png": 3}
    assert files.refused["renders/link.png"] == files.refused["folder"] == "a link"
    assert files.refused["pipe.png"] == "not a regular file"
    assert any("deep" in why for why in files.refused.values())
    assert files.read("renders/a.png", 10) == b"abc"


def test_file_replaced_after_the_listing_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"abc")
    files = open_untrusted(tmp_path)
    (tmp_path / "a.png").unlink()
    (tmp_path / "a.png").symlink_to("/etc/hostname")
    with pytest.raises(UntrustedError, match="cannot be read"):
        files.read("a.png", 100)
    (tmp_path / "a.png").unlink()
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(UntrustedError, match="not a regular file"):
        files.read("a.png", 100)


def test_reading_stays_within_the_byte_limit(tmp_path: Path) -> None:
    with (tmp_path / "sparse.png").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(UntrustedError, match="too large"):
        open_untrusted(tmp_path).read("sparse.png", 1000)


def archive(path: Path, **options: int) -> zipfile.ZipFile:
    return zipfile.ZipFile(path, "w", options.get("method", zipfile.ZIP_DEFLATED))


def test_zip_is_read_in_place(tmp_path: Path) -> None:
    with archive(tmp_path / "s.zip") as file:
        file.writestr("manifest.json", "{}")
        file.writestr("renders/a.png", b"abc")
        file.mkdir("empty")
    files = open_untrusted(tmp_path / "s.zip")
    assert files.sizes == {"manifest.json": 2, "renders/a.png": 3}
    assert files.read("renders/a.png", 3) == b"abc"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.zip"]


@pytest.mark.parametrize("zipped", [False, True])
def test_number_of_files_is_limited(zipped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(untrusted, "MAX_ENTRIES", 3)
    for count in (3, 4):
        root = tmp_path / f"{count}"
        root.mkdir()
        for number in range(count):
            (root / f"{number}.png").write_bytes(b"abc")
        if zipped:
            with archive(tmp_path / f"{count}.zip") as file:
                for path in root.iterdir():
                    file.write(path, path.name)
            root = tmp_path / f"{count}.zip"
        if count == 3:
            assert open_untrusted(root).sizes == {f"{number}.png": 3 for number in range(3)}
        else:
            with pytest.raises(UntrustedError, match="more than 3 files"):
                open_untrusted(root)


@pytest.mark.parametrize(
    "name", ["../up.png", "/etc/passwd", "a/../../b", "C:/x", "a\\b", "a//b", "./a"], ids=lambda name: name
)
def test_zip_paths_out_of_the_archive_are_refused(tmp_path: Path, name: str) -> None:
    with archive(tmp_path / "s.zip") as file:
        file.writestr(zipfile.ZipInfo(name), b"x")
    files = open_untrusted(tmp_path / "s.zip")
    assert not files.sizes
    assert len(files.refused) == 1


def test_unsafe_zip_entries_are_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("link.png")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    secret = zipfile.ZipInfo("secret.png")
    with archive(tmp_path / "s.zip") as file:
        file.writestr(link, "/etc/passwd")
        file.writestr("bomb.png", bytes(50_000_000))
        file.writestr("twice.png", b"one")
        with pytest.warns(UserWarning, match="Duplicate"):
            file.writestr("twice.png", b"two")
        file.writestr(secret, b"secret")
    data = bytearray((tmp_path / "s.zip").read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = 0
        while (place := data.find(signature, place)) >= 0:
            if b"secret.png" in data[place : place + 60]:
                data[place + offset] |= 1
            place += 4
    (tmp_path / "s.zip").write_bytes(bytes(data))
    files = open_untrusted(tmp_path / "s.zip")
    assert files.refused["link.png"].startswith("a link")
    assert "times its compressed size" in files.refused["bomb.png"]
    assert files.refused["twice.png"] == "twice in the archive"
    assert files.refused["secret.png"] == "encrypted"


def test_zip_with_wrong_sizes_is_read_within_the_limit(tmp_path: Path) -> None:
    with archive(tmp_path / "s.zip") as file:
        file.writestr("a.png", bytes(100_000))
    data = (tmp_path / "s.zip").read_bytes()
    at = data.find(b"PK\x01\x02") + 24
    (tmp_path / "s.zip").write_bytes(data[:at] + (50).to_bytes(4, "little") + data[at + 4 :])
    files = open_untrusted(tmp_path / "s.zip")
    with contextlib.suppress(UntrustedError):
        assert len(files.read("a.png", 60)) <= 60


def test_broken_zips_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("no zip")
    with pytest.raises(UsageError, match="neither"):
        open_untrusted(tmp_path / "a.txt")
    with pytest.raises(UsageError, match="neither"):
        open_untrusted(tmp_path / "none")
    with archive(tmp_path / "s.zip") as file:
        file.writestr("a.png", os.urandom(5000))
    data = bytearray((tmp_path / "s.zip").read_bytes())
    (tmp_path / "cut.zip").write_bytes(data[:3000])
    with pytest.raises(UntrustedError, match="a zip that is cut off"):
        open_untrusted(tmp_path / "cut.zip")
    data[2000] ^= 1
    (tmp_path / "s.zip").write_bytes(bytes(data))
    with pytest.raises(UntrustedError):
        open_untrusted(tmp_path / "s.zip").read("a.png", 10_000)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"[" * 200_000, "deep"),
        (b'{"a":' * 100_000, "deep"),
        (b'{"a": NaN}', "NaN"),
        (b'{"a": -Infinity}', "Infinity"),
        (b'{"a": ' + b"9" * 5000 + b"}", "valid JSON"),
        (b"\xff\xfe", "valid JSON"),
        (b'{"a": 1', "valid JSON"),
        (b" " * 2_000_000, "too large"),
    ],
    ids=["arrays", "objects", "nan", "infinity", "digits", "bytes", "cut", "large"],
)
def test_harmful_json_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(UntrustedError, match=words):
        parse_untrusted(data, "manifest.json", 1 << 20)


def test_plain_json_is_read() -> None:
    assert parse_untrusted(json.dumps({"a": [1, 2.5, None]}).encode(), "a", 100) == {"a": [1, 2.5, None]}
