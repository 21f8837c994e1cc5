"""The error for weights that are missing or have another hash."""

from __future__ import annotations

from mirror.errors import MirrorError


class WeightsUnavailableError(MirrorError):
    """Weights are missing or are not the published ones; the remedy names their sources."""
