"""The error of a refused result."""

from __future__ import annotations

from mirror.errors import MirrorError


class RefusedError(MirrorError):
    """A result cannot be added to the board."""
