"""``python -m mean_color DATASET --split NAME --out SUBMISSION``."""

from __future__ import annotations

import sys

from mirror.cli.method import method_main
from mirror_baselines.mean_color import APPEARANCE, METHOD, render

if __name__ == "__main__":
    sys.exit(method_main(sys.argv[1:], render, METHOD, APPEARANCE))
