"""The error of a result that is turned down."""

from __future__ import annotations

from mirror.errors import MirrorError


class RefusedError(MirrorError):
    """A result that cannot stand on the board."""
