"""``python -m hybridworldsim.mvs DATASET --split NAME --method plane-sweep``."""

from __future__ import annotations

import sys

from mirror.stops import run_process


def _main() -> int:
    from hybridworldsim.mvs.command import main

    return main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(run_process("python -m hybridworldsim.mvs", _main))
