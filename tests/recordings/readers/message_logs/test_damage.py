"""Truncated and damaged logs: what can be read is read, what cannot is counted, and nothing ends in a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.cli.main import main
from mirror.errors import MirrorError, RecordingError
from mirror.recordings.boundary import reader_errors
from mirror.recordings.readers.message_logs.mcap_file import McapFile
from tests.draws import draws
from tests.recordings.readers.message_logs.drives import ONE, opened
from tests.recordings.readers.message_logs.writer import TOPICS, messages, write_mcap, write_rosbag2


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("share", [0.3, 0.45, 0.62])
def test_what_precedes_a_cut_is_read(tmp_path: Path, chunked: bool, share: float) -> None:
    file = write_mcap(tmp_path / "log.mcap", messages(ONE), chunked=chunked)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * share)])
    recording = opened(tmp_path)
    track = recording.track()
    assert track.bad is not None and "truncated" in str(track.bad.first)
    # The last fix may have lost the orientation that would follow it.
    assert track.bad.counts()["file"] == 1 and track.bad.counts().get("rotation", 0) <= 1
    assert 0.1 * len(ONE.stamps) < len(track) <= len(ONE.stamps)
    np.testing.assert_array_equal(track.timestamp_ns, ONE.stamps[: len(track)])
    stream = recording.images()["front_wide"]
    count = len(stream.exposure_start_ns)
    assert dict(stream.read(range(count))) == dict(enumerate(ONE.images[:count]))


@pytest.mark.parametrize("cut", [0, 4, 8, 9, 20, 40])
@pytest.mark.parametrize("chunked", [True, False])
def test_a_log_cut_before_its_first_topic_is_truncated_and_not_empty(
    tmp_path: Path, cut: int, chunked: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_mcap(tmp_path / "log.mcap", messages(ONE), chunked=chunked)
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(RecordingError, match=f"truncated at byte {cut}"):
        McapFile(file).topics()
    assert main(["info", str(file)]) == 2
    said = capsys.readouterr().err
    assert f"truncated at byte {cut}" in said and "log.mcap" in said


def test_a_damaged_chunk_costs_only_its_own_messages(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "log.mcap", messages(ONE))
    log = McapFile(file)
    fixes = list(log.messages(["/fix"]))
    blocks = sorted({message.place.block for message in fixes})
    data = bytearray(file.read_bytes())
    middle = blocks[len(blocks) // 2]
    data[middle + 200] ^= 0xFF
    file.write_bytes(bytes(data))
    left = [message.log_time_ns for message in McapFile(file).messages(["/fix"])]
    assert left == [message.log_time_ns for message in fixes if message.place.block != middle]
    track = opened(tmp_path).track()
    assert track.bad is not None and track.bad.counts()["file"] == 1
    assert f"chunk at byte {middle}" in str(track.bad.first)


def test_a_chunk_that_claims_more_than_it_has_is_not_allocated(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "log.mcap", messages(ONE))
    block = next(iter(McapFile(file).messages(["/tf_static"]))).place.block
    data = bytearray(file.read_bytes())
    # After opcode and length: start and end of time, then the size without compression.
    data[block + 9 + 16 : block + 9 + 24] = (2**62).to_bytes(8, "little")
    file.write_bytes(bytes(data))
    log = McapFile(file)
    assert sum(1 for _ in log.messages(["/fix"])) > 0
    assert [str(error.place) for error in log.damage()] == [f"chunk at byte {block}"]


def test_messages_that_do_not_follow_their_definition_are_counted(tmp_path: Path) -> None:
    every = messages(ONE)
    file = write_mcap(tmp_path / "log.mcap", every, chunked=False)
    log = McapFile(file)
    one = list(log.messages(["/fix"]))[7]
    data = bytearray(file.read_bytes())
    # The length of the frame's name in the header: after 4 bytes of encapsulation and 8 of the stamp.
    data[one.place.offset + 12 : one.place.offset + 16] = (2**31).to_bytes(4, "little")
    file.write_bytes(bytes(data))
    track = opened(tmp_path).track()
    assert track.bad is not None and track.bad.counts() == {"file": 1}
    np.testing.assert_array_equal(track.timestamp_ns, np.delete(ONE.stamps, 7))


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "truncated at byte 0"), (b"RIFF" * 100, "is not an MCAP file"), (b"\x89MCAP0\r\n", "truncated at byte 8")],
)
def test_files_that_are_no_log(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "log.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        opened(tmp_path)


def test_damaged_databases_are_refused_by_name(tmp_path: Path) -> None:
    file = write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=True)
    whole = file.read_bytes()
    for damaged in (b"", whole[:100], b"SQLite format 3\0" + b"x" * 4096):
        file.write_bytes(damaged)
        with pytest.raises(RecordingError) as caught:
            opened(tmp_path).track()
        assert caught.value.file == str(file)


@settings(max_examples=draws(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flips=st.integers(1, 8), chunked=st.booleans())
def test_any_damage_ends_in_a_named_error_or_in_values(
    tmp_path_factory: pytest.TempPathFactory, seed: int, flips: int, chunked: bool
) -> None:
    folder = tmp_path_factory.mktemp("damage")
    file = write_mcap(folder / "log.mcap", messages(ONE)[:90], chunked=chunked)
    data = bytearray(file.read_bytes())
    rng = np.random.default_rng(seed)
    for place in rng.integers(8, len(data), flips):
        data[place] = rng.integers(0, 256)
    file.write_bytes(bytes(data))
    try:
        with reader_errors(file):
            recording = opened(folder, TOPICS)
            track = recording.track()
            assert len(track.timestamp_ns) <= 90
            for stream in recording.images().values():
                list(stream.read(range(len(stream.exposure_start_ns))))
    except MirrorError as error:
        assert str(folder) in str(error)
