"""The door: byte strings found inside others, and frames of videos that stay found in videos that leave."""

from __future__ import annotations

import hashlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mirror.dataset.door.files import RECORDED, ImageFile
from mirror.dataset.door.inspection import inspect_files, read_below
from mirror.dataset.door.plan import Departure, KeptFile, Why
from mirror.dataset.door.search import ByteSearch
from mirror.dataset.door.secrets import Secrets
from mirror.dataset.store import Store
from mirror.progress import NullProgress


def test_byte_strings_are_found_wherever_they_begin() -> None:
    random = np.random.default_rng(3)
    strings = [random.bytes(int(size)) for size in random.integers(128, 4000, 60)] + [bytes(4096), b"ab" * 500]
    search = ByteSearch()
    for one in strings:
        search.add(one, hashlib.sha256(one).hexdigest())
    hay, expected = b"", set()
    for one in strings[::3]:
        hay += random.bytes(int(random.integers(0, 50)))
        expected.add((len(hay), len(one), hashlib.sha256(one).hexdigest()))
        hay += one
    assert expected <= set(search.find(hay))
    for start, length, sha256 in search.find(hay):
        assert hashlib.sha256(hay[start : start + length]).hexdigest() == sha256
    assert not list(search.find(b"".join(one[:-1] for one in strings[:20])))
    assert not list(search.find(b""))


def test_a_frame_that_stays_is_found_in_a_video_that_leaves(tmp_path: Path) -> None:
    """Copies of stretches of one recording begin at a key frame, and so have frames before the stretch."""
    av = pytest.importorskip("av")
    from mirror.recordings.remux import copy_frames

    random = np.random.default_rng(0)
    source = tmp_path / "source.mp4"
    with av.open(str(source), "w") as container:
        stream = container.add_stream("mpeg4", rate=10, options={"sc_threshold": "1000000000"})
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 64, 48, "yuv420p", 30
        for number in range(24):
            frame = av.VideoFrame.from_ndarray(random.integers(0, 256, (48, 64, 3)).astype(np.uint8), "rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with av.open(str(source)) as container:
        pts = np.array(sorted(packet.pts for packet in container.demux(video=0) if packet.pts is not None), np.int64)
    stretches = {"stays": pts[4:10], "leaves": pts[8:16]}
    own = {name: copy_frames(source, wanted, tmp_path / f"{name}.mp4") for name, wanted in stretches.items()}

    def rows(name: str) -> list[ImageFile]:
        data = (tmp_path / f"{name}.mp4").read_bytes()
        digest = hashlib.sha256(data).hexdigest()
        return [
            ImageFile(
                (name, "rear", int(stamp)), RECORDED, f"{name}.mp4", 0, len(data), "video", int(one), digest, (64, 48)
            )
            for stamp, one in zip(stretches[name], own[name])
        ]

    kept = tuple(KeptFile(one, Why.WITHHELD) for one in rows("stays"))
    shown = {one.key: one for one in rows("leaves")}
    departure = Departure(
        files={"leaves.mp4": None}, static_masks=frozenset(), shown=shown, kept=kept, withheld=("stays.mp4",)
    )
    secrets = Secrets(Store(tmp_path), departure, NullProgress())
    found = inspect_files(read_below(tmp_path), ["leaves.mp4"], departure, secrets, NullProgress())
    assert {one.problem.rpartition("/")[2] for one in found.leaks} == {str(stamp) for stamp in pts[4:8]}
    assert {one.shown for one in found.same_bytes} == {f"leaves/rear/{stamp}" for stamp in pts[8:10]}
    whole = inspect_files(read_below(tmp_path), ["stays.mp4"], departure, secrets, NullProgress())
    assert [one.file for one in whole.leaks] == ["stays.mp4"]
