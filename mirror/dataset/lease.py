"""The lease of a dataset: at most one run at a time removes or rewrites what others may read, on whatever machine.

The writer lock is one of the operating system: it does not reach machines whose file systems do not share locks, and
there is none in a bucket. A lease is a file that names its holder, its purpose and when it expires. It is renewed while
the work goes on; one that has expired, or whose process is known to be dead, may be taken over. Runs that only append
need none. Wall-clock time stands in this file alone; clocks of machines may differ by `CLOCKS_DIFFER_S`.
"""

from __future__ import annotations

import os
import platform
import random
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from pydantic import AwareDatetime

from mirror.dataset.destination import Destination
from mirror.dataset.lease_file import LeaseFile, SeenLease, lease_file
from mirror.dataset.owned_folder import UNKNOWN, boot_id
from mirror.errors import DatasetError, MirrorError
from mirror.schema.documents import Document
from mirror.schema.files import encode_json, parse_json

DURATION_S: Final = 120.0
"""A lease that was not renewed for so long has expired; it is renewed four times in that time."""
CLOCKS_DIFFER_S: Final = 30.0
"""Another machine takes a lease over so long after it has expired."""
_BYTES: Final = 1024
_RENEWALS: Final = 4
_FIRST_PAUSE_S: Final = 0.02
_LONGEST_PAUSE_S: Final = 2.0
_CLOCK: Final = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""It also counts the time for which a machine sleeps."""


class LeaseLostError(DatasetError):
    """A run has lost its lease: it could not renew it in time, or another run has taken it over."""


class LeaseDocument(Document):
    """``.lease.json``: who has the lease of a dataset.

    Attributes:
        holder: machine and process, for messages; empty: nobody.
        purpose: what it is held for, such as ``gc``.
        since: when it was taken.
        expires: when it expires, unless it is renewed.
        token: tells this lease from all others.
        process: identifies the process on its machine; empty: it cannot be identified.
    """

    holder: str
    purpose: str
    since: AwareDatetime
    expires: AwareDatetime
    token: str
    process: str = ""


class Lease:
    """A lease that this process holds; see `hold_lease`.

    Args:
        file: the lease's file.
        document: what it says.
        duration_s: how long it lasts without a renewal.
        deadline: when it expires, on the clock of this machine that never goes back, in seconds.
    """

    def __init__(self, file: LeaseFile, document: LeaseDocument, duration_s: float, deadline: float) -> None:
        self._file = file
        self._document = document
        self._duration_s = duration_s
        self._deadline = deadline
        self._is_lost = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep, daemon=True, name="lease")
        self._thread.start()

    def require(self) -> None:
        """Require that this process still holds the lease; whoever removes or rewrites something calls it before.

        Raises:
            LeaseLostError: it does not.
        """
        if self._is_lost or time.clock_gettime(_CLOCK) >= self._deadline:
            raise LeaseLostError(
                f"the lease for {self._document.purpose} was lost: it could not be renewed in time",
                file=self._file.place, expected=f"a renewal within {self._duration_s:g} s",
                remedy="run the same command again: it finishes what this run left",
            )  # fmt: skip

    def end(self) -> None:
        """Give the lease up; one that was lost stays as it is."""
        self._ended.set()
        self._thread.join()
        # What cannot be given up expires.
        with suppress(OSError, MirrorError):
            self._file.remove()

    def _keep(self) -> None:
        while not self._ended.wait(self._duration_s / _RENEWALS):
            if time.clock_gettime(_CLOCK) >= self._deadline:
                # Another run may have taken it over: a late renewal must not undo that.
                self._is_lost = True
                return
            begin = time.clock_gettime(_CLOCK)
            document = self._document.model_copy(update={"expires": _now() + timedelta(seconds=self._duration_s)})
            try:
                if not self._file.renew(_encode(document)):
                    self._is_lost = True
                    return
            except (OSError, MirrorError):
                # The next renewal may succeed; until then the deadline stands.
                continue
            self._deadline = begin + self._duration_s


@contextmanager
def hold_lease(
    destination: Destination, purpose: str, *, wait: bool = False, duration_s: float = DURATION_S
) -> Iterator[Lease]:
    """Hold the lease of a dataset, and renew it until the block ends.

    Args:
        destination: the dataset: a folder that exists, or a bucket.
        purpose: what it is held for, in a word or two, for those who are refused.
        wait: wait for another holder; False: raise an error at once.
        duration_s: how long it lasts without a renewal.

    Raises:
        DatasetError: another run holds the lease and ``wait`` is false, or the file is damaged or cannot be written.
        UsageError: the server of a bucket does not keep conditions.
    """
    document = LeaseDocument(
        holder=f"{platform.node()}:{os.getpid()}", purpose=purpose, since=_now(), expires=_now(),
        token=secrets.token_hex(8), process=_own_process(),
    )  # fmt: skip
    lease = _acquire(destination, document, duration_s, wait=wait)
    try:
        yield lease
    finally:
        lease.end()


def _acquire(destination: Destination, document: LeaseDocument, duration_s: float, *, wait: bool) -> Lease:
    file = lease_file(destination, _encode(document.model_copy(update={"holder": "", "process": ""})))
    pause_s = _FIRST_PAUSE_S
    while True:
        begin, now = time.clock_gettime(_CLOCK), _now()
        mine = document.model_copy(update={"since": now, "expires": now + timedelta(seconds=duration_s)})
        seen = file.read()
        theirs = None if seen is None else _parse(file, seen)
        if seen is None or theirs is None:
            is_mine = file.create(_encode(mine))
        elif _is_free(theirs, now):
            is_mine = file.take(seen, _encode(mine))
        elif wait:
            # Those that wait must not all come back together.
            time.sleep(pause_s * random.uniform(0.5, 1.0))
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
            continue
        else:
            raise DatasetError(
                f"another run holds the lease of this dataset: {theirs.holder}, for {theirs.purpose}, since "
                f"{theirs.since:%Y-%m-%d %H:%M:%S %Z}", file=file.place,
                expected=f"no lease, or one that expired {CLOCKS_DIFFER_S:g} s ago; this one expires at "
                f"{theirs.expires:%H:%M:%S} unless it is renewed",
                remedy="let it finish; verbs that have --wait can wait for it",
            )  # fmt: skip
        if is_mine:
            return Lease(file, mine, duration_s, begin + duration_s)


def _is_free(document: LeaseDocument, now: datetime) -> bool:
    """Return whether a lease was given up, has expired, or is held by a process of this machine that is dead."""
    if not document.holder or now > document.expires + timedelta(seconds=CLOCKS_DIFFER_S):
        return True
    return _is_dead(document.process)


def _parse(file: LeaseFile, seen: SeenLease) -> LeaseDocument | None:
    """Parse a lease; None: its holder was just writing it, and it is another one by now."""
    try:
        return parse_json(seen.data, LeaseDocument, file.place)
    except MirrorError as error:
        again = file.read()
        if again is None:
            return None
        if again != seen:
            return _parse(file, again)
        raise DatasetError(
            "the lease is damaged, so that nothing says who holds it", file=file.place,
            expected="a lease that a run wrote", remedy="remove the file if no such run is working",
        ) from error  # fmt: skip


def _encode(document: LeaseDocument) -> bytes:
    """Encode a lease, always with the same number of bytes."""
    return encode_json(document).rstrip().ljust(_BYTES - 1) + b"\n"


def _now() -> datetime:
    return datetime.now(UTC)


def _own_process() -> str:
    return _identify(os.getpid()) or ""


def _identify(process: int) -> str | None:
    """Identify a process by boot, process namespace, number and start; None: there is none, or no way to tell."""
    try:
        namespace = os.readlink("/proc/self/ns/pid")  # noqa: PTH115 - not the path of a file
        # The name of the program, in parentheses, may have spaces.
        started = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return None
    return None if boot_id() == UNKNOWN else f"{boot_id()} {namespace} {process} {started}"


def _is_dead(identity: str) -> bool:
    """Return whether a process is known to be dead: it was one of this boot and namespace, and is there no more."""
    own, parts = _own_process().split(), identity.split()
    if len(parts) != 4 or len(own) != 4 or parts[:2] != own[:2] or not parts[2].isdigit():
        return False
    try:
        os.kill(int(parts[2]), 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        # It is another user's.
        pass
    now = _identify(int(parts[2]))
    return now is not None and now != identity
