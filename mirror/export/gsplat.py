"""The layout that gsplat's example ``Parser`` reads: a COLMAP model with the lenses that it knows.

Its ``Parser(data_dir)`` reads ``sparse/0`` and ``images``. It undistorts images itself, and takes every eighth image in
the order of names for tests; the lists in ``splits/`` state the roles of a MIRROR split.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from mirror.export.colmap import LAYOUT as COLMAP
from mirror.export.colmap import write_sparse_model
from mirror.export.layout import Written
from mirror.export.lenses import gsplat_lens
from mirror.export.scene import ExportScene
from mirror.progress import ProgressReporter


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    return write_sparse_model(scene, out / "sparse" / "0", gsplat_lens)


LAYOUT: Final = replace(
    COLMAP,
    name="gsplat",
    title="the data of gsplat's example trainer (a COLMAP model)",
    lens_of=gsplat_lens,
    write=_write,
)
