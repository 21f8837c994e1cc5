"""The organiser's public keys of a board, ``keys.json``: each counts for signatures made between two dates."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import Field, model_validator

from mirror.errors import SchemaError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, sha256_bytes
from mirror_leaderboard.signing import parse_public_key

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

KEYS: Final = "keys.json"
"""File of a board with the public keys of its organiser."""

_ID_CHARACTERS: Final = 16

KeyId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class OrganiserKey(Document):
    """A public key of a board's organiser.

    Attributes:
        id: the first 16 hexadecimal digits of the SHA-256 of the key's 32 bytes.
        public: the key, ed25519, 32 bytes in base64.
        since: first day on which its signatures count.
        until: last day on which its signatures count; None: it is in use.
    """

    id: KeyId
    public: Annotated[str, Field(pattern=r"^[A-Za-z0-9+/]{43}=$")]
    since: date
    until: date | None = None

    @model_validator(mode="after")
    def _consistent(self) -> OrganiserKey:
        if self.id != key_id(self.public):
            raise ValueError(f"the id of this key is {key_id(self.public)}, not {self.id}")
        if self.until is not None and self.until < self.since:
            raise ValueError(f"key {self.id} ends before it begins")
        return self

    def counts_on(self, day: date) -> bool:
        """Return whether a signature made on a day counts."""
        return self.since <= day and (self.until is None or day <= self.until)


class OrganiserKeys(Document):
    """``keys.json``: the public keys of a board, oldest first. The last one is in use; all others have ended.

    Attributes:
        keys: the keys.
    """

    keys: tuple[OrganiserKey, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _ordered(self) -> OrganiserKeys:
        if len({key.id for key in self.keys}) < len(self.keys):
            raise ValueError("a key is listed twice")
        if self.keys[-1].until is not None or any(key.until is None for key in self.keys[:-1]):
            raise ValueError("exactly one key is in use, and it is the last one")
        return self

    @property
    def current(self) -> OrganiserKey:
        """The key in use."""
        return self.keys[-1]

    def find(self, identifier: str | None) -> OrganiserKey | None:
        """Return the key with an id; None if it is not listed."""
        return next((key for key in self.keys if key.id == identifier), None)

    def rotated(self, public: str, day: date) -> OrganiserKeys:
        """Return the keys with a new key, which replaces the current one from a day on."""
        ended = self.current.model_copy(update={"until": max(day, self.current.since)})
        new = OrganiserKey(id=key_id(public), public=public, since=day)
        return OrganiserKeys(keys=(*self.keys[:-1], ended, new))


def key_id(public: str) -> str:
    """Return the id of a public key in base64."""
    return sha256_bytes(base64.b64decode(public))[:_ID_CHARACTERS]


def read_keys(board: Path) -> OrganiserKeys | None:
    """Read the public keys of a board; None if it has none.

    Raises:
        SchemaError: the file is broken.
    """
    path = board / KEYS
    return read_json(path, OrganiserKeys) if path.is_file() else None


def load_public_keys(board: Path, keys: Sequence[OrganiserKey]) -> dict[str, Ed25519PublicKey]:
    """Load listed keys by their ids.

    Raises:
        SchemaError: a key is not a point of the curve.
        UsageError: `cryptography` is not installed.
    """
    loaded = {}
    for key in keys:
        try:
            loaded[key.id] = parse_public_key(key.public)
        except ValueError as error:
            raise SchemaError(
                f"key {key.id} is not an ed25519 key",
                file=board / KEYS,
                place="keys",
                remedy="restore keys.json from the version history of the board",
            ) from error
    return loaded
