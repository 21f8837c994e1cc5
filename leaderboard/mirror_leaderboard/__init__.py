"""The leaderboard: one JSON file for each entry, and a static site built from the entries (docs/leaderboard.md)."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command("benchmark", "put results on a leaderboard, and build its site", "mirror_leaderboard.command")
