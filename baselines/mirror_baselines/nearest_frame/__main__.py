"""``python -m mirror_baselines.nearest_frame DATASET --split NAME --out SUBMISSION``."""

from __future__ import annotations

import sys

from mirror.stops import run_process


def main() -> int:
    """Run the command line."""
    from mirror.cli.method import method_main
    from mirror_baselines.nearest_frame import APPEARANCE, METHOD, render

    return method_main(sys.argv[1:], render, METHOD, APPEARANCE)


if __name__ == "__main__":
    sys.exit(run_process("python -m mirror_baselines.nearest_frame", main))
