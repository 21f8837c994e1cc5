"""Logs of `ros2 bag record --compression-format zstd`: single messages, or the file as a whole."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import zstandard

from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.recordings.readers.message_logs.contents import read_contents
from mirror.recordings.registry import open_recording
from tests.builders.folder import LAT, LON
from tests.recordings.readers.message_logs.drives import ONE, opened, require_drive
from tests.recordings.readers.message_logs.writer import TOPICS, messages, write_mcap, write_rosbag2


def _compress_messages(file: Path) -> Path:
    with closing(sqlite3.connect(file)) as database:
        for row, data in database.execute("SELECT id, data FROM messages").fetchall():
            packed = zstandard.ZstdCompressor().compress(data)
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, row))
        database.commit()
    return file


def _compress_file(file: Path) -> Path:
    packed = file.with_name(file.name + ".zstd")
    packed.write_bytes(zstandard.ZstdCompressor().compress(file.read_bytes()))
    file.unlink()
    return packed


def test_compressed_messages_are_read(tmp_path: Path) -> None:
    _compress_messages(write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=True))
    require_drive(opened(tmp_path), ONE)


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_compressed_files_are_read(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / f"log{suffix}"
    _ = write_mcap(log, messages(ONE)) if suffix == ".mcap" else write_rosbag2(log, messages(ONE), definitions=True)
    packed, out = _compress_file(log), tmp_path.with_name(f"dataset{suffix}")
    (tmp_path / "log.toml").write_text(TOPICS)
    require_drive(open_recording(packed), ONE)  # type: ignore[arg-type]
    # Recognised in a folder, proposed, and ingested under its own name; nothing is unpacked beside it.
    (tmp_path / "log.toml").unlink()
    assert main(["info", str(packed)]) == ExitCode.DONE
    assert f"# Save as {tmp_path / 'log.toml'}" in capsys.readouterr().out
    (tmp_path / "log.toml").write_text(TOPICS)
    words = ["ingest", str(tmp_path), "--roi", f"{LON},{LAT},150", "--out", str(out)]
    assert main(words) == ExitCode.DONE
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["log.toml", packed.name])


def test_a_folder_of_compressed_files_is_one_drive(tmp_path: Path) -> None:
    every = messages(ONE)
    for number, part in enumerate((every[:150], every[150:])):
        _compress_file(write_rosbag2(tmp_path / f"bag_{number}.db3", part, definitions=False))
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / "topics.toml").write_text(TOPICS)
    require_drive(open_recording(tmp_path), ONE)  # type: ignore[arg-type]


def test_damaged_compression_is_named(tmp_path: Path) -> None:
    packed = _compress_file(write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=True))
    packed.write_bytes(packed.read_bytes()[:1_000])
    (tmp_path / "log.toml").write_text(TOPICS)
    with pytest.raises(RecordingError) as caught:
        open_recording(packed)
    assert caught.value.file == str(packed)
    packed.unlink()
    file = _compress_messages(write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=True))
    with closing(sqlite3.connect(file)) as database:
        (row, data) = database.execute("SELECT id, data FROM messages WHERE topic_id = 2 LIMIT 1").fetchone()
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (data[:-9], row))
        # A frame that claims a tebibyte.
        huge = b"\x28\xb5\x2f\xfd\xe0" + (2**40).to_bytes(8, "little") + data[10:]
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (huge, row + 1))
        database.commit()
    recording = opened(tmp_path)
    damage = read_contents(recording.logs, recording.document).damage
    assert 1 <= len(damage) <= 2 and all(error.file == str(file) for error in damage)
