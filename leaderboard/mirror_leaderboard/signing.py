"""Signatures of entries: the organiser signs what the board states, and `build` shows no measured row without one."""

from __future__ import annotations

import base64
import binascii
import os
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final

from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.schema.files import unwritable_error

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

KEY_BYTES: Final = 32


def new_key(path: Path) -> str:
    """Write a new private key that only its owner can read, and return the public key in base64.

    Raises:
        UsageError: the file exists, or `cryptography` is not installed.
        DatasetError: the file cannot be written.
    """
    key = _ed25519().Ed25519PrivateKey.generate()
    try:
        # 0600 from the beginning: nobody can read the key between its writing and a change of its mode.
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise UsageError(
            "a file exists",
            file=path,
            expected="a new file for the private key",
            remedy="name a new file; a lost key is replaced by `mirror leaderboard rotate`",
        ) from error
    except OSError as error:
        raise unwritable_error(path, error) from error
    with os.fdopen(number, "wb") as file:
        file.write(base64.b64encode(key.private_bytes_raw()) + b"\n")
    return encode_public_key(key.public_key())


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """Read the organiser's private key.

    Raises:
        UsageError: the file is missing or not a private key, or `cryptography` is not installed.
    """
    data = _read_key(path, "a private key of `mirror leaderboard key`")
    key: Ed25519PrivateKey = _ed25519().Ed25519PrivateKey.from_private_bytes(data)
    return key


def parse_public_key(text: str) -> Ed25519PublicKey:
    """Parse a public key in base64.

    Raises:
        ValueError: it is not a public key.
        UsageError: `cryptography` is not installed.
    """
    key: Ed25519PublicKey = _ed25519().Ed25519PublicKey.from_public_bytes(base64.b64decode(text, validate=True))
    return key


def encode_public_key(key: Ed25519PublicKey) -> str:
    """Encode a public key in base64."""
    return base64.b64encode(key.public_bytes_raw()).decode()


def sign(key: Ed25519PrivateKey, content: bytes) -> str:
    """Sign bytes, and return the signature in base64."""
    return base64.b64encode(key.sign(content)).decode()


def is_signed(key: Ed25519PublicKey, content: bytes, signature: str) -> bool:
    """Return whether a signature of these bytes was made by the owner of a key."""
    from cryptography.exceptions import InvalidSignature

    try:
        key.verify(base64.b64decode(signature, validate=True), content)
    except (InvalidSignature, binascii.Error, ValueError):
        return False
    return True


def _read_key(path: Path, expected: str) -> bytes:
    try:
        data = base64.b64decode(path.read_bytes().strip(), validate=True)
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", file=path, expected=expected) from error
    except (binascii.Error, ValueError) as error:
        raise UsageError("not base64", file=path, expected=expected) from error
    if len(data) != KEY_BYTES:
        raise UsageError(f"{len(data)} bytes", file=path, expected=f"{expected}: {KEY_BYTES} bytes in base64")
    return data


def _ed25519() -> ModuleType:
    try:
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError as error:
        raise UsageError("signatures need the package cryptography", remedy=install_command("leaderboard")) from error
    return ed25519
