"""Tracks against true tracks: identity switches, MOTA over recall, IDF1."""

from __future__ import annotations

from mirror.metrics.tracking.scores import TrackedBoxes, TrackingScores, score_tracks

__all__ = ["TrackedBoxes", "TrackingScores", "score_tracks"]
