"""The vault: a folder outside of dataset and release with what links a release to its originals.

It holds the key of the pseudonyms and the private log: hashes of originals beside those of the released images. It is
what a removal request needs, and what a release must not contain.
"""

from __future__ import annotations

import datetime
import os
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, Literal

from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_bytes, write_json
from mirror.schema.strict_json import decode_json

VAULT: Final = "vault.json"
PRIVATE_LOG: Final = "originals.jsonl"


class Vault(Document):
    """``vault.json``: the key that renames a release's ids, and the date until which it is kept.

    Attributes:
        format: always ``mirror-vault``.
        key: key of the pseudonyms, in hexadecimal.
        retain_until: date from which on the vault is to be deleted, ISO 8601; None: not stated.
    """

    format: Literal["mirror-vault"] = "mirror-vault"
    key: str
    retain_until: str | None = None


class OriginalRecord(Document):
    """One line of the private log.

    Attributes:
        released: ``traversal/camera/timestamp_ns`` in the release.
        recorded: the same in the dataset.
        out_sha256: SHA-256 of the released bytes.
        in_sha256: SHA-256 of the recorded bytes.
        in_pixel_sha256: SHA-256 of the decoded pixels of the recorded image; empty: it has no regions.
    """

    released: str
    recorded: str
    out_sha256: str
    in_sha256: str
    in_pixel_sha256: str = ""


def open_vault(folder: Path, outside_of: Iterable[Path], retain_days: int | None) -> Vault:
    """Read a vault, or make one that only its owner can read.

    Args:
        folder: the vault.
        outside_of: folders that must not contain it.
        retain_days: days after which a new vault is to be deleted; None: not stated.

    Raises:
        UsageError: it lies in one of these folders.
    """
    resolved = folder.absolute().resolve()
    for other in outside_of:
        if other.absolute().resolve() in (resolved, *resolved.parents):
            raise UsageError(
                f"the vault lies inside {other}", file=folder, place="--vault",
                expected="a folder outside of the dataset and of the release", remedy="name another folder",
            )  # fmt: skip
    if (folder / VAULT).is_file():
        return read_json(folder / VAULT, Vault)
    until = None
    if retain_days is not None:
        until = (datetime.datetime.now(datetime.UTC).date() + datetime.timedelta(days=retain_days)).isoformat()
    vault = Vault(key=secrets.token_hex(32), retain_until=until)
    folder.mkdir(parents=True, exist_ok=True)
    os.chmod(folder, 0o700)  # noqa: PTH101
    write_json(folder / VAULT, vault)
    return vault


def is_expired(vault: Vault) -> bool:
    """Return whether the vault should have been deleted."""
    return (
        vault.retain_until is not None and datetime.datetime.now(datetime.UTC).date().isoformat() > vault.retain_until
    )


def write_private_log(folder: Path, release: str, records: Iterable[OriginalRecord]) -> Path:
    """Write the private log of a release, in a file with the release's name."""
    path = folder / f"{release}.{PRIVATE_LOG}"
    write_bytes(path, "".join(f"{one.model_dump_json()}\n" for one in records).encode())
    return path


def read_private_logs(folder: Path) -> list[OriginalRecord]:
    """Read all private logs of a vault."""
    found = []
    for path in sorted(folder.glob(f"*.{PRIVATE_LOG}")):
        lines: list[Mapping[str, str]] = [decode_json(line) for line in path.read_text().splitlines()]
        found += [OriginalRecord.model_validate(line) for line in lines]
    return found
