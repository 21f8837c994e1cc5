"""Reading ahead out of a bucket: few requests, few bytes for nothing, bounded memory, and the same batches as ever."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mirror
from benchmarks.loader import make_dataset, read_frames, read_shuffled
from mirror.dataset.read_ahead import ByteRange, ReadAhead, coalesce
from mirror.dataset.store import Store
from mirror.dataset.torch import FrameDataset, IterableFrames
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.s3 import served_bucket

FRAMES = 24
URL = f"s3://{BUCKET}/shards"


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("read_ahead") / "shards"
    make_dataset(root, FRAMES, shards=True)
    return root


@pytest.fixture
def bucket(local: Path) -> Iterator[Bucket]:
    with served_bucket() as served:
        for path in local.rglob("*"):
            if path.is_file():
                served.objects[path.relative_to(local.parent).as_posix()] = path.read_bytes()
        yield served


ranges = st.lists(st.builds(ByteRange, st.sampled_from("ab"), st.integers(0, 500), st.integers(1, 60)), max_size=30)


@given(ranges, st.integers(0, 40), st.integers(1, 200))
def test_spans_hold_every_range_once_and_no_wider_gap_than_allowed(
    asked: list[ByteRange], gap: int, limit: int
) -> None:
    spans = coalesce(asked, gap_bytes=gap, limit_bytes=limit)
    assert sorted(one for span in spans for one in span.ranges) == sorted(set(asked))
    for span in spans:
        wanted = {at for one in span.ranges for at in range(one.offset, one.offset + one.length)}
        assert (min(wanted), max(wanted) + 1) == (span.start, span.end)
        assert all(one.uri == span.uri for one in span.ranges)
        assert len(span.ranges) == 1 or span.end - span.start <= limit
        holes = np.diff(sorted(wanted)) - 1
        assert not len(holes) or holes.max() <= gap


def test_requests_and_bytes_of_frames_in_order_and_shuffled(bucket: Bucket, local: Path) -> None:
    here = mirror.open(local)
    own = sum(here.table("images", ["byte_length"]).column(0).to_pylist())
    for read, most in ((read_frames, 0.15), (read_shuffled, 0.2)):
        dataset = mirror.open(URL)
        bucket.requests.clear()
        assert list(read(dataset)) == list(read(here))
        assert bucket.count() / (14 * FRAMES) <= most
        assert sum(request.sent for request in bucket.requests) <= 1.1 * own


def test_a_frame_alone_is_one_request(bucket: Bucket, local: Path) -> None:
    frame, here = mirror.open(URL).frames()[3], mirror.open(local).frames()[3]
    assert len(frame.images) == 7
    bucket.requests.clear()
    np.testing.assert_array_equal(frame.decode(), here.decode())
    assert bucket.count() == 1
    samples = FrameDataset(mirror.open(URL), boxes=False)
    samples[0]
    bucket.requests.clear()
    assert len(samples.__getitems__([4, 5, 6])) == 3 and bucket.count() == 1


def steps(batches: Iterator[dict[str, object]]) -> list[object]:
    """Return the numbers, frames and pixels of batches."""
    return [(batch["step"], batch["frame_index"].tolist(), batch["images"].numpy().tobytes()) for batch in batches]


def test_batches_of_ranks_workers_and_a_resumed_run_are_those_of_a_disk(bucket: Bucket, local: Path) -> None:
    def made(place: str | Path, **more: int) -> IterableFrames:
        return IterableFrames(mirror.open(place), 5, ["rear", "front_wide"], seed=3, boxes=False, **more)

    for rank in range(2):
        expected = steps(iter(made(local, rank=rank, world_size=2)))
        assert steps(iter(made(URL, rank=rank, world_size=2))) == expected and len(expected) == 5
    whole = steps(iter(made(local)))
    # Nothing is left of what the first run had asked for.
    first = made(URL)
    used = next(iter(first))
    resumed = made(URL)
    resumed.load_state_dict(first.state_dict(used))
    assert steps(iter(resumed)) == whole[1:]
    assert not first.samples.frames._loader.read_ahead._held


def test_no_more_is_held_than_the_window(bucket: Bucket) -> None:
    class Counted(ReadAhead):
        most = 0

        def request(self, ranges: Iterator[ByteRange]) -> None:
            super().request(ranges)
            self.most = max(self.most, sum(one.length for one in self._held))

    ahead = Counted(Store(f"s3://{BUCKET}"))
    bucket.objects["big"] = np.random.default_rng(1).bytes(1 << 20)
    groups = [[ByteRange("big", start, 4096)] for start in range(0, 1 << 20, 4096)]
    for group in ahead.over(groups, lambda one: one, window_bytes=1 << 16):
        (one,) = group
        assert ahead.take(*one) == bucket.objects["big"][one.offset :][:4096]
    assert 0 < ahead.most <= 1 << 16 and not ahead._held
    assert bucket.count() <= 2 * (1 << 20) // (1 << 16) + 2
    assert ahead.take("big", 0, 4096) is None


def test_what_cannot_be_read_is_an_error_where_it_is_used(bucket: Bucket) -> None:
    (shard,) = [key for key in bucket.objects if "d0" in key and key.endswith(".tar")]
    frames = mirror.open(URL).frames()
    del bucket.objects[shard]
    before = threading.active_count()
    with pytest.raises(mirror.errors.DatasetError, match=r"images-00000\.tar"):
        [image.read() for frame in frames for image in frame.images.values()]
    assert threading.active_count() - before <= 16
