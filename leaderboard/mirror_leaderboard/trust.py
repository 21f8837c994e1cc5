"""What a board's site may show: measured entries with the organiser's signature, reported ones that were reviewed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, sha256_bytes, write_json
from mirror_leaderboard.entry import Entry, Hash, Measured, Reported, load_entries, load_entry_files
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.signing import (
    PUBLIC_KEY,
    encode_public_key,
    is_signed,
    read_private_key,
    read_public_key,
    sign,
    write_public_key,
)

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
        RefusedError: a measured entry has no signature of the organiser, or a reported one is not in the reviewed list.
        UsageError: the organiser's public key is broken, or `cryptography` is not installed.
    """
    measured = [entry for entry in entries if isinstance(entry, Measured)]
    reported = [entry for entry in entries if isinstance(entry, Reported)]
    if measured:
        path = board / PUBLIC_KEY
        if not path.is_file():
            raise RefusedError(
                f"has {len(measured)} measured entries and no public key of its organiser",
                file=path,
                remedy="mirror leaderboard sign --board BOARD --key FILE, or --unsigned for a draft",
            )
        key = read_public_key(path)
        for entry in measured:
            if entry.signature is None or not is_signed(key, entry.signed_content, entry.signature):
                problem = "has no signature" if entry.signature is None else "has a signature of another key or content"
                raise RefusedError(
                    f"{entry.method} {entry.version} ({entry.protocol}, {entry.dataset}) {problem}",
                    file=board / "entries",
                    remedy="mirror leaderboard sign --board BOARD --key FILE, or --unsigned for a draft",
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


def sign_entries(board: Path, key_file: Path) -> list[Measured]:
    """Sign the measured entries of a board that lack the organiser's signature, and write the public key.

    Returns:
        The entries that were signed now.

    Raises:
        UsageError: the key cannot be read, or the board belongs to another key.
        SchemaError: an entry is broken, or was changed after it was added.
        DatasetError: a file cannot be written.
    """
    key = read_private_key(key_file)
    public, path = key.public_key(), board / PUBLIC_KEY
    files = load_entry_files(board / "entries")
    if not path.is_file():
        write_public_key(path, public)
    elif encode_public_key(read_public_key(path)) != encode_public_key(public):
        raise UsageError("the board has the public key of another organiser", file=path, place="--key")
    signed = []
    for file, entry in files.items():
        if isinstance(entry, Measured):
            if entry.signature is not None and is_signed(public, entry.signed_content, entry.signature):
                continue
            entry = entry.model_copy(update={"signature": sign(key, entry.signed_content)})
            write_json(file, entry)
            signed.append(entry)
    return signed


def hash_reported(entry: Reported) -> str:
    """SHA-256 of the canonical content of a reported entry."""
    return sha256_bytes(json.dumps(entry.model_dump(mode="json"), sort_keys=True, separators=(",", ":")).encode())


def list_rows(folder: Path) -> ReviewedRows:
    """List the reported entries of a folder as rows of ``reviewed.json``, for a reviewer who compared them."""
    reported = [entry for entry in load_entries(folder) if isinstance(entry, Reported)]
    return ReviewedRows(
        rows=tuple(
            ReviewedRow(
                paper=entry.paper.title, table=entry.paper.table, row=entry.paper.row, sha256=hash_reported(entry)
            )
            for entry in reported
        )
    )
