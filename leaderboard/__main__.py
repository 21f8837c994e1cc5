"""``python -m leaderboard build|add ...``."""

from __future__ import annotations

import sys

import tyro

from leaderboard.refused import RefusedError
from mirror.command_line import parsed
from mirror.errors import ExitCode, MirrorError, UsageError

FOLDER: Final = Path(__file__).parent
"""Holds ``entries`` and ``pictures``."""
from mirror.cli.command import run_process
from mirror.cli.stops import run_process


def _main() -> int:
    from leaderboard.command import main

    return main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(run_process("python -m leaderboard", _main))
