"""The leaderboard: one JSON an entry, and a static site built of them (docs/leaderboard.md)."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command("benchmark", "put results on a leaderboard, and build its site", "mirror_leaderboard.command")
