"""``python -m benchmarks.plates.training.prepare FONTS OUT``: writes what samples are drawn from.

FONTS holds the unpacked packages that `training_fonts` names. OUT receives ``glyphs.npz`` and ``backgrounds.npz``: with
these two files the training needs neither typefaces nor the synthetic streets.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.plates.backgrounds import photographs, render_streets, save_backgrounds
from benchmarks.plates.fonts import draw_glyphs, save_glyphs, training_fonts

_STREETS: Final = 96
_SEED: Final = 500
_QUALITY: Final = 88


def main(argv: Sequence[str]) -> int:
    fonts, out = map(Path, argv)
    out.mkdir(parents=True, exist_ok=True)
    save_glyphs(out / "glyphs.npz", draw_glyphs(training_fonts(fonts)))
    backgrounds = [*render_streets(_STREETS, _SEED), *photographs()]
    save_backgrounds(out / "backgrounds.npz", backgrounds, _QUALITY)
    print(f"{out}: {len(backgrounds)} backgrounds, {sum(len(one.places_px) for one in backgrounds)} places of plates")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
