"""The one error that says that weights are missing or not those they should be."""

from __future__ import annotations

from mirror.errors import MirrorError


class WeightsUnavailableError(MirrorError):
    """Weights that are needed are not there, or are others; the remedy says how to get the right ones."""
