"""Leases: one holder at a time, on disks and in buckets, whatever happens to the holder."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset import lease as leases
from mirror.dataset.destination import BucketDestination, Destination, FolderDestination
from mirror.dataset.garbage import collect_garbage
from mirror.dataset.lease import Lease, LeaseLostError, hold_lease
from mirror.dataset.lease_file import NAME, FolderLeaseFile
from mirror.dataset.migration import migrate
from mirror.errors import DatasetError, UsageError
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.dataset import write_two_drives
from tests.builders.s3 import moto_bucket, served_bucket
from tests.processes import Running

URL = f"s3://{BUCKET}/street"
SHORT_S = 0.4


@pytest.fixture
def bucket() -> Iterator[Bucket]:
    with served_bucket() as served:
        yield served


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Destination:
    if request.param == "folder":
        return FolderDestination(tmp_path)
    request.getfixturevalue("bucket")
    return BucketDestination(URL)


def overwrite(place: Destination, bucket: Bucket | None, **changes: str) -> None:
    """Let the lease say something else, as a holder on another machine would."""
    data = place.store.read(NAME)
    changed = json.dumps({**json.loads(data), **changes}).encode().ljust(len(data))
    if bucket is None:
        Path(place.store.root, NAME).write_bytes(changed)
    else:
        bucket.objects[f"street/{NAME}"] = changed


def of_elsewhere(request: pytest.FixtureRequest, place: Destination, expires_in_s: float) -> None:
    """Leave a lease of a machine that is gone."""
    bucket = request.getfixturevalue("bucket") if isinstance(place, BucketDestination) else None
    with hold_lease(place, "gc"):
        left = place.store.read(NAME)
    if bucket is None:
        Path(place.store.root, NAME).write_bytes(left)
    else:
        bucket.objects[f"street/{NAME}"] = left
    expires = datetime.now(UTC) + timedelta(seconds=expires_in_s)
    overwrite(place, bucket, holder="elsewhere:7", process="", expires=expires.isoformat())


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def is_lost(lease: Lease) -> bool:
    try:
        lease.require()
    except LeaseLostError as error:
        assert error.remedy is not None and "run the same command again" in error.remedy
        return True
    return False


def test_a_second_holder_is_refused_by_name_and_purpose(place: Destination) -> None:
    with hold_lease(place, "first purpose") as lease:
        lease.require()
        with pytest.raises(DatasetError) as caught, hold_lease(place, "second"):
            pass
        text = str(caught.value)
        assert f":{os.getpid()}, for first purpose, since {datetime.now(UTC):%Y-%m-%d}" in text
        assert "--wait" in text
    with hold_lease(place, "second"):
        pass
    if isinstance(place, FolderDestination):
        assert not list(place.root.iterdir())


def test_who_waits_gets_it_next_and_nobody_holds_it_with_another(place: Destination) -> None:
    inside, most, turns = 0, 0, []

    def work(number: int) -> None:
        nonlocal inside, most
        with hold_lease(place, str(number), wait=True) as lease:
            inside += 1
            most = max(most, inside)
            time.sleep(0.005)
            lease.require()
            turns.append(number)
            inside -= 1

    threads = [threading.Thread(target=work, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert most == 1 and sorted(turns) == list(range(6))


def test_a_lease_is_renewed_while_the_work_goes_on(place: Destination, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "_RENEWALS", 1000)
    with hold_lease(place, "gc", duration_s=30.0) as lease:
        first = json.loads(place.store.read(NAME))
        until(lambda: json.loads(place.store.read(NAME)) != first)
        lease.require()
        renewed = json.loads(place.store.read(NAME))
        assert renewed["expires"] > first["expires"]
        assert {**renewed, "expires": None} == {**first, "expires": None}


def test_an_expired_one_is_taken_over_and_its_holder_learns_it(
    place: Destination, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "_RENEWALS", 1000)
    of_elsewhere(request, place, -leases.CLOCKS_DIFFER_S + 25.0)
    with pytest.raises(DatasetError, match="elsewhere:7"), hold_lease(place, "take-down"):
        pass
    bucket = request.getfixturevalue("bucket") if isinstance(place, BucketDestination) else None
    expired = datetime.now(UTC) - timedelta(seconds=leases.CLOCKS_DIFFER_S + 1.0)
    overwrite(place, bucket, expires=expired.isoformat())
    with hold_lease(place, "take-down", duration_s=30.0) as lease:
        assert json.loads(place.store.read(NAME))["purpose"] == "take-down"
        # Somebody else takes this one over too: as if its holder had slept.
        document = place.store.read(NAME)
        if bucket is None:
            Path(place.store.root, NAME).unlink()
            Path(place.store.root, NAME).write_bytes(document)
        else:
            bucket.objects[f"street/{NAME}"] = document.replace(b"take-down", b"take-away")
        until(lambda: is_lost(lease))
    # What another one holds is not removed.
    assert json.loads(place.store.read(NAME))["purpose"] == ("take-down" if bucket is None else "take-away")


def test_a_bucket_is_asked_under_conditions_alone(bucket: Bucket, request: pytest.FixtureRequest) -> None:
    place = BucketDestination(URL)
    of_elsewhere(request, place, -leases.CLOCKS_DIFFER_S - 1.0)
    bucket.requests.clear()
    with hold_lease(place, "gc"):
        pass
    puts = [one for one in bucket.requests if one.method == "PUT"]
    assert all("if-match" in put.headers or put.headers.get("if-none-match") == "*" for put in puts)
    # Taken over; a put that must fail shows that the server keeps the condition; given up.
    assert [put.status for put in puts] == [200, 412, 200]
    assert json.loads(bucket.objects[f"street/{NAME}"])["holder"] == ""
    bucket.is_lenient = True
    with pytest.raises(UsageError, match="in spite of If-Match"), hold_lease(place, "gc"):
        pass


def test_another_implementation_of_s3_holds_leases() -> None:
    with moto_bucket():
        place = BucketDestination("s3://fleet/street")
        for _ in range(2):
            with hold_lease(place, "gc") as lease:
                lease.require()
                with pytest.raises(DatasetError, match="for gc"), hold_lease(place, "again"):
                    pass


def test_a_lease_that_was_renewed_meanwhile_is_not_taken_over(tmp_path: Path) -> None:
    holder, taker = FolderLeaseFile(tmp_path), FolderLeaseFile(tmp_path)
    assert holder.create(b"old") and not taker.create(b"new")
    seen = taker.read()
    assert seen is not None and holder.renew(b"now")
    assert not taker.take(seen, b"new") and (tmp_path / NAME).read_bytes() == b"now" and holder.renew(b"yet")
    seen = taker.read()
    assert seen is not None and taker.take(seen, b"new") and not holder.renew(b"old")
    holder.remove()
    assert (tmp_path / NAME).read_bytes() == b"new"
    taker.remove()
    assert not list(tmp_path.iterdir())


def hold_until_asked(folder: str, asked: str) -> None:
    with hold_lease(FolderDestination(Path(folder)), "gc", duration_s=SHORT_S) as lease:
        while not Path(asked).exists():
            time.sleep(0.005)
        try:
            lease.require()
        except LeaseLostError:
            Path(asked).write_text("lost")


def test_a_process_that_is_killed_holds_nothing_and_one_that_slept_learns_its_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, asked = tmp_path / "dataset", tmp_path / "asked"
    folder.mkdir()
    place = FolderDestination(folder)
    with Running(hold_until_asked, folder, asked) as running:
        until((folder / NAME).exists)
        with pytest.raises(DatasetError, match=f":{running.process}, for gc"), hold_lease(place, "gc"):
            pass
        running.send(signal.SIGKILL)
        running.wait()
        # It has not expired, but its process is known to be dead.
        with hold_lease(place, "gc"):
            pass
    monkeypatch.setattr(leases, "CLOCKS_DIFFER_S", 0.0)
    with Running(hold_until_asked, folder, asked) as running:
        until((folder / NAME).exists)
        running.send(signal.SIGSTOP)
        with hold_lease(place, "take-down", wait=True) as lease:
            asked.touch()
            running.send(signal.SIGCONT)
            assert running.wait() == 0 and asked.read_text() == "lost"
            lease.require()
    assert not list(folder.iterdir())


def test_verbs_that_remove_are_refused_while_another_machine_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    root = write_two_drives(tmp_path / "d", b"x" * 1000)
    of_elsewhere(request, FolderDestination(root), 60.0)
    for run in (collect_garbage, migrate):
        with pytest.raises(DatasetError, match="elsewhere:7, for gc, since 20"):
            run(root)
    assert main(["dataset", "gc", str(root)]) == 2 and "elsewhere:7" in capsys.readouterr().err
    (root / NAME).write_bytes(b"{")
    with pytest.raises(DatasetError, match="remove the file if no such run is working"):
        collect_garbage(root)
    (root / NAME).unlink()
    assert main(["dataset", "gc", str(root)]) == 0 and not (root / NAME).exists()
