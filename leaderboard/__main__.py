"""``python -m leaderboard build|add ...``."""

from __future__ import annotations

import sys

from mirror.stops import run_process


def _main() -> int:
    from leaderboard.command import main

    return main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(run_process("python -m leaderboard", _main))
