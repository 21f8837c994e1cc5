"""Former versions of protocols whose tables the board still shows, each with the key that ranked it."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files

from mirror.protocols.ranking import Ranking
from mirror.schema.documents import Document


class FormerVersion(Document):
    """A former version of a protocol.

    Attributes:
        protocol: name of the protocol.
        version: its version.
        hash: its hash, which the measured entries of its tables state.
        ranking: the figure that ranked its tables.
    """

    protocol: str
    version: int
    hash: str
    ranking: Ranking


def find_former(protocol_hash: str) -> FormerVersion | None:
    """Find the former version that has a hash; None if the board knows no such version."""
    return next((former for former in _read() if former.hash == protocol_hash), None)


@cache
def _read() -> tuple[FormerVersion, ...]:
    plain = tomllib.loads(files("mirror_leaderboard").joinpath("former.toml").read_text())
    return tuple(FormerVersion.model_validate(row) for row in plain["versions"])
