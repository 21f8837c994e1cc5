"""Names in a bucket that get their bytes once: what is on the wire, what is repeated, and who wins."""

from __future__ import annotations

import hashlib
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from mirror.dataset import destination
from mirror.dataset.destination import BucketDestination, FolderDestination, bucket_at
from mirror.errors import UnwritableError, UsageError
from mirror.schema.commit import ConflictError
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.s3 import served_bucket

COMMITTERS, ROUNDS = 16, 20
URL = f"s3://{BUCKET}/street"


@pytest.fixture
def bucket() -> Iterator[Bucket]:
    with served_bucket() as served:
        yield served


def test_a_put_carries_the_condition_and_equal_bytes_are_done(bucket: Bucket, tmp_path: Path) -> None:
    place = bucket_at(URL)
    (tmp_path / "made").write_bytes(b"equal")
    assert place.commit_bytes("a/b.json", b"equal")
    assert not place.commit_bytes("a/b.json", b"equal") and not place.commit_file(tmp_path / "made", "a/b.json")
    puts = [request for request in bucket.requests if request.method == "PUT"]
    # 412 is not repeated: the bytes that are there are read and compared.
    assert [(put.headers["if-none-match"], put.status) for put in puts] == [("*", 200), ("*", 412), ("*", 412)]
    assert bucket.objects == {"street/a/b.json": b"equal"} and place.store.read("a/b.json") == b"equal"
    assert not pickle.loads(pickle.dumps(place)).commit_bytes("a/b.json", b"equal")


def test_a_file_in_parts_carries_the_condition_where_it_is_completed(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(destination, "PART_BYTES", 5 << 20)
    place, made = BucketDestination(URL), tmp_path / "made"
    made.write_bytes(b"0123456789abcdef" * (11 << 16))
    assert place.commit_file(made, "big") and not place.commit_file(made, "big")
    with pytest.raises(ConflictError):
        place.commit_bytes("big", made.read_bytes()[::-1])
    ends = [one for one in bucket.requests if one.method == "POST" and "uploadId" in one.query]
    assert [(end.headers["if-none-match"], end.status) for end in ends] == [("*", 200), ("*", 412), ("*", 412)]
    assert bucket.objects == {"street/big": made.read_bytes()}


def test_other_bytes_are_an_error_that_names_both(bucket: Bucket) -> None:
    place = BucketDestination(URL)
    place.commit_bytes("key", b"theirs")
    with pytest.raises(ConflictError) as caught:
        place.commit_bytes("key", b"mine")
    text = str(caught.value)
    assert f"{URL}/key" in text
    assert all(hashlib.sha256(data).hexdigest() in text for data in (b"mine", b"theirs"))
    assert bucket.objects["street/key"] == b"theirs"


def test_409_is_repeated_and_other_refusals_are_not(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(destination, "_FIRST_PAUSE_S", 0.0001)
    monkeypatch.setattr(destination, "_LONGEST_PAUSE_S", 0.0001)
    place = BucketDestination(URL)
    bucket.refusals = [409, 409, 409]
    assert place.commit_bytes("key", b"mine") and bucket.count("PUT") == 4
    bucket.refusals = [403]
    with pytest.raises(UnwritableError, match="AWS_ACCESS_KEY_ID"):
        place.commit_bytes("other", b"mine")
    assert bucket.count("PUT") == 5
    bucket.refusals = [409] * 99
    with pytest.raises(UnwritableError):
        place.commit_bytes("other", b"mine")
    assert "street/other" not in bucket.objects


def test_one_of_sixteen_committers_of_a_key_wins_and_the_others_name_both(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(destination, "_FIRST_PAUSE_S", 0.004)
    bucket.hold_s = 0.004
    place = BucketDestination(URL)
    for number in range(ROUNDS):
        key, start = f"key{number}", threading.Barrier(COMMITTERS)
        won: list[int] = []
        said: dict[int, str] = {}

        def commit(writer: int, key: str, start: threading.Barrier, won: list[int], said: dict[int, str]) -> None:
            start.wait()
            try:
                assert place.commit_bytes(key, f"of writer {writer}".encode())
                won.append(writer)
            except ConflictError as error:
                said[writer] = str(error)

        threads = [threading.Thread(target=commit, args=(one, key, start, won, said)) for one in range(COMMITTERS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
        (winner,) = won
        data = f"of writer {winner}".encode()
        assert bucket.objects[f"street/{key}"] == data and len(said) == COMMITTERS - 1
        for writer, text in said.items():
            mine = hashlib.sha256(f"of writer {writer}".encode()).hexdigest()
            assert hashlib.sha256(data).hexdigest() in text and mine in text
    statuses = [request.status for request in bucket.requests if request.method == "PUT"]
    assert statuses.count(200) == ROUNDS and statuses.count(409) > ROUNDS
    assert statuses.count(412) == ROUNDS * (COMMITTERS - 1)


def test_a_folder_is_complete_with_its_last_file(bucket: Bucket, tmp_path: Path) -> None:
    for name in ("manifest.json", "z.parquet", "images/a.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    BucketDestination(URL).commit_folder(tmp_path, "there", "manifest.json")
    keys = [request.key for request in bucket.requests if request.method == "PUT"]
    assert sorted(keys[:2]) == ["street/there/images/a.jpg", "street/there/z.parquet"]
    assert keys[2:] == ["street/there/manifest.json"]


def test_a_server_that_ignores_the_condition_is_refused(bucket: Bucket) -> None:
    place = BucketDestination(URL)
    place.commit_bytes("dataset.json", b"{}")
    place.require_conditional_puts("dataset.json", b"{}")
    bucket.is_lenient = True
    with pytest.raises(UsageError, match="ignores If-None-Match"):
        place.require_conditional_puts("dataset.json", b"{}")


def test_other_stores_are_refused(tmp_path: Path) -> None:
    for url in ("gs://bucket/street", "memory://street", "zip::street.zip", "https://example.org/street"):
        with pytest.raises(UsageError, match="or s3://BUCKET/PATH"):
            bucket_at(url)
    with pytest.raises(UsageError, match="names no bucket"):
        bucket_at("s3://")
    folder = FolderDestination(tmp_path)
    assert folder.commit_bytes("a/b", b"one") and (tmp_path / "a" / "b").read_bytes() == b"one"
