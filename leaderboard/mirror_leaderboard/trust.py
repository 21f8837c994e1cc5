"""Entries that a site may show: measured ones with the organiser's signature, reported ones that were reviewed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_json
from mirror.schema.hashing import HashStyle, hash_document
from mirror_leaderboard.entry import Entry, Hash, Measured, Reported, load_entries, load_entry_files
from mirror_leaderboard.keys import KEYS, OrganiserKey, OrganiserKeys, key_id, load_public_keys, read_keys
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.signing import encode_public_key, is_signed, read_private_key, sign

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

_SIGN: Final = "mirror leaderboard sign --board BOARD --key FILE, or --unsigned for a draft"
_REVIEWED: Final = Path(__file__).parent / "papers" / "reviewed.json"


class ReviewedRow(Document):
    """A row of a paper that a reviewer compared with its entry.

    Attributes:
        paper: title of the paper.
        table: number of the table.
        row: the paper's name of the row.
        sha256: hash of the entry.
    """

    paper: str
    table: int
    row: str
    sha256: Hash


class ReviewedRows(Document):
    """``papers/reviewed.json``: the rows of papers that the board may show."""

    rows: tuple[ReviewedRow, ...]


def require_trusted(board: Path, entries: Sequence[Entry]) -> None:
    """Check the entries of a board before they are shown.

    Raises:
        RefusedError: a measured entry has no signature of a listed key that counts on its day, or a reported one is not
            in the reviewed list.
        SchemaError: the board's list of public keys is broken.
        UsageError: `cryptography` is not installed.
    """
    measured = [entry for entry in entries if isinstance(entry, Measured)]
    reported = [entry for entry in entries if isinstance(entry, Reported)]
    if measured:
        keys = read_keys(board)
        if keys is None:
            raise RefusedError(
                f"has {len(measured)} measured entries and no public key of its organiser",
                file=board / KEYS,
                remedy=_SIGN,
            )
        public = load_public_keys(board, keys.keys)
        for entry in measured:
            problem = _find_signature_problem(entry, keys, public)
            if problem is not None:
                raise RefusedError(
                    f"{entry.method} {entry.version} ({entry.protocol}, {entry.dataset}) {problem}",
                    file=board / "entries",
                    remedy=_SIGN,
                )
    known = {(row.paper, row.table, row.row, row.sha256) for row in read_json(_REVIEWED, ReviewedRows).rows}
    for other in reported:
        if (other.paper.title, other.paper.table, other.paper.row, hash_reported(other)) not in known:
            raise RefusedError(
                f"{other.method} of {other.paper.title!r}, Table {other.paper.table}, row {other.paper.row!r}, is "
                "not in the list of reviewed rows, or was changed after its review",
                file=board / "entries",
                remedy=f"have the row reviewed and listed in {_REVIEWED.name}",
            )


def sign_entries(board: Path, key_file: Path, day: date | None = None) -> list[Measured]:
    """Sign the measured entries of a board without a counting signature; the first key of a board is listed.

    Args:
        board: folder of the board.
        key_file: the private key.
        day: day of the signatures; None: today (UTC).

    Returns:
        The entries that were signed now.

    Raises:
        UsageError: the key cannot be read, or the board has another key in use.
        SchemaError: an entry is broken or was changed after it was added, or the list of keys is broken.
        DatasetError: a file cannot be written.
    """
    day = day or today()
    key = read_private_key(key_file)
    public = encode_public_key(key.public_key())
    files = load_entry_files(board / "entries")
    keys = read_keys(board)
    if keys is None:
        keys = OrganiserKeys(keys=(OrganiserKey(id=key_id(public), public=public, since=day),))
        write_json(board / KEYS, keys)
    elif keys.current.public != public:
        raise UsageError(
            f"the board's key in use is {keys.current.id}, not {key_id(public)}",
            file=board / KEYS,
            place="--key",
            remedy="a new key takes the place of a lost one by: mirror leaderboard rotate --key FILE",
        )
    loaded = load_public_keys(board, keys.keys)
    signed = []
    for file, entry in files.items():
        if isinstance(entry, Measured) and _find_signature_problem(entry, keys, loaded) is not None:
            signed.append(_sign_entry(file, entry, key, day))
    return signed


@dataclass(frozen=True)
class Rotation:
    """The result of a rotation of keys.

    Attributes:
        former: the key that ended.
        current: the key in use from now on.
        signed: entries that were signed again.
        left: entries without a signature that counted; they were not signed.
    """

    former: OrganiserKey
    current: OrganiserKey
    signed: tuple[Measured, ...]
    left: tuple[Measured, ...]


def rotate_key(board: Path, key_file: Path, day: date | None = None) -> Rotation:
    """Replace the board's key, and sign all entries again that a listed key had signed.

    The former key stays in the list with the day on which it ended. Entries without a signature that counts are left.
    An interrupted call continues where it stopped.

    Args:
        board: folder of the board.
        key_file: the new private key.
        day: day of the rotation; None: today (UTC).

    Raises:
        UsageError: the key cannot be read, has ended, or the board has no key yet.
        SchemaError: an entry is broken or was changed after it was added, or the list of keys is broken.
        DatasetError: a file cannot be written.
    """
    day = day or today()
    key = read_private_key(key_file)
    public = encode_public_key(key.public_key())
    files = load_entry_files(board / "entries")
    keys = read_keys(board)
    if keys is None:
        raise UsageError("the board has no key yet", file=board / KEYS, remedy="mirror leaderboard sign --key FILE")
    if keys.current.public != public:
        if keys.find(key_id(public)) is not None:
            raise UsageError(f"key {key_id(public)} has ended", file=key_file, remedy="mirror leaderboard key")
        keys = keys.rotated(public, day)
        write_json(board / KEYS, keys)
    elif len(keys.keys) == 1:
        raise UsageError("this key is in use already", file=key_file, remedy="mirror leaderboard key makes a new one")
    loaded = load_public_keys(board, keys.keys)
    signed, left = [], []
    for file, entry in files.items():
        if isinstance(entry, Measured) and entry.key != keys.current.id:
            if _find_signature_problem(entry, keys, loaded) is None:
                signed.append(_sign_entry(file, entry, key, day))
            else:
                left.append(entry)
    return Rotation(keys.keys[-2], keys.current, tuple(signed), tuple(left))


def today() -> date:
    """Return the day in UTC."""
    return datetime.now(UTC).date()


def _sign_entry(file: Path, entry: Measured, key: Ed25519PrivateKey, day: date) -> Measured:
    identifier = key_id(encode_public_key(key.public_key()))
    entry = entry.model_copy(update={"key": identifier, "signed_on": day, "signature": None})
    entry = entry.model_copy(update={"signature": sign(key, entry.signed_content)})
    write_json(file, entry)
    return entry


def _find_signature_problem(entry: Measured, keys: OrganiserKeys, public: Mapping[str, Ed25519PublicKey]) -> str | None:
    """Find the reason why the signature of an entry does not count; None: it does."""
    if entry.signature is None or entry.signed_on is None:
        return "has no signature"
    key = keys.find(entry.key)
    if key is None:
        return f"has a signature of key {entry.key}, which the board does not list"
    if not is_signed(public[key.id], entry.signed_content, entry.signature):
        return "has a signature of another key or content"
    if not key.counts_on(entry.signed_on):
        return f"was signed on {entry.signed_on}; key {key.id} counts from {key.since} to {key.until or 'today'}"
    return None


def hash_reported(entry: Reported) -> str:
    """Return the SHA-256 of the canonical content of a reported entry."""
    return hash_document(entry.model_dump(mode="json"), HashStyle.CANONICAL)


def list_rows(folder: Path) -> ReviewedRows:
    """List the reported entries of a folder as rows of ``reviewed.json``, for the reviewer of their papers."""
    reported = [entry for entry in load_entries(folder) if isinstance(entry, Reported)]
    return ReviewedRows(
        rows=tuple(
            ReviewedRow(
                paper=entry.paper.title, table=entry.paper.table, row=entry.paper.row, sha256=hash_reported(entry)
            )
            for entry in reported
        )
    )
