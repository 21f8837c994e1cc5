"""Seeds of the street: public ones, which anybody can name, and secret ones, which stay with an organiser.

A public seed is a small number, and its random streams are those of numpy. A secret seed has 128 random bits, and each
of its streams starts from the HMAC-SHA-256 (RFC 2104) of the purpose and the words of the stream under that seed. The
published part of one stream, such as the errors of poses, gives neither the seed nor another stream, such as traffic.
"""

from __future__ import annotations

import hmac
import secrets
from typing import Final

import numpy as np

from mirror.errors import UsageError

PUBLIC_SEEDS: Final = 1 << 31
"""Public seeds are below this number."""

_EXPECTED: Final = f"a whole number from 0 to {PUBLIC_SEEDS - 1}"
_MAX_DIGITS: Final = 10
_BITS: Final = 128
_INTEGER_HASHES: Final = 1 << 31


def draw_secret_seed() -> int:
    """Draw a secret seed from the operating system: 128 random bits below a highest bit of 1."""
    return 1 << _BITS | secrets.randbits(_BITS)


def pack_secret_seed(seed: int) -> str:
    """Return the random bits of a secret seed, 32 hexadecimal digits."""
    return f"{seed - (1 << _BITS):0{_BITS // 4}x}"


def unpack_secret_seed(text: str) -> int:
    """Return the secret seed of 32 hexadecimal digits."""
    return 1 << _BITS | int(text, 16)


def is_secret_seed(seed: int) -> bool:
    """Return whether a seed is secret, or derived from a secret seed."""
    return seed >> _BITS == 1


def require_public_seed(seed: int, place: str = "--seed") -> None:
    """Refuse a number that is no public seed.

    Raises:
        UsageError: the seed is out of range; the message does not repeat a secret one.
    """
    if not 0 <= seed < PUBLIC_SEEDS:
        raise UsageError("a secret seed" if is_secret_seed(seed) else f"{seed}", place=place, expected=_EXPECTED)


def parse_public_seed(text: str, place: str) -> int:
    """Parse a public seed, for instance from the name of a street.

    Raises:
        UsageError: the text is no whole number, or the number is out of range; the message does not repeat it.
    """
    if not (text.isdecimal() and text.isascii() and len(text) <= _MAX_DIGITS):
        raise UsageError("not a public seed", place=place, expected=_EXPECTED)
    require_public_seed(int(text), place)
    return int(text)


def name_seed(seed: int) -> str:
    """Name a seed for a message, without showing a secret seed."""
    return "its secret seed" if is_secret_seed(seed) else f"seed {seed}"


def seed_sequence(purpose: str, seed: int, *words: int) -> np.random.SeedSequence:
    """Return the seed sequence of one random stream.

    Args:
        purpose: use of the stream; it separates the streams of a secret seed, and does not change public ones.
        seed: public, secret or derived seed.
        words: numbers of the stream, of at least 0.
    """
    if is_secret_seed(seed):
        return np.random.SeedSequence(int.from_bytes(_digest(purpose, seed, words)))
    return np.random.SeedSequence([seed, *words])


def random_stream(purpose: str, seed: int, *words: int) -> np.random.Generator:
    """Return the generator of one random stream; see `seed_sequence`."""
    return np.random.default_rng(seed_sequence(purpose, seed, *words))


def derive_seed(purpose: str, seed: int, *words: int, public: int) -> int:
    """Derive a secret seed for a purpose from a secret seed; for a public seed, return ``public``."""
    if is_secret_seed(seed):
        return 1 << _BITS | int.from_bytes(_digest(purpose, seed, words)) >> _BITS
    return public


def derive_hash_seed(purpose: str, seed: int, *words: int, public: int) -> int:
    """Derive a 31-bit seed, for integer hashes, from a secret seed; for a public seed, return ``public``."""
    return derive_seed(purpose, seed, *words, public=public) % _INTEGER_HASHES if is_secret_seed(seed) else public


def _digest(purpose: str, seed: int, words: tuple[int, ...]) -> bytes:
    message = "/".join([purpose, *(str(int(word)) for word in words)])
    return hmac.digest(seed.to_bytes(_BITS // 8 + 1), message.encode(), "sha256")
