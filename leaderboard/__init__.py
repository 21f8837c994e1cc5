"""The leaderboard: one JSON an entry, and a static site built of them (docs/leaderboard.md)."""
