"""Exports for other toolkits to read: ``python -m tests.export.peers FOLDER`` writes one for each.

``tests/peers/<name>/read.py`` reads it in an environment of its own, and writes ``tests/peers/<name>/result.json``,
which the tests compare with the dataset.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from mirror.dataset.dataset import Dataset
from mirror.export.run import ExportOptions, export
from tests.export.street import LENSES, make_street

RESULTS = Path(__file__).resolve().parents[1] / "peers"
PERSPECTIVE = tuple(name for name, lens in LENSES.items() if lens.model in ("pinhole", "brown_conrady"))


def export_nuscenes(street: Dataset, out: Path) -> None:
    """All cameras, undistorted, with boxes."""
    export(street, "nuscenes", out, ExportOptions(undistort=True))


def export_nerfstudio(street: Dataset, out: Path) -> None:
    """The cameras whose lenses nerfstudio has, distorted, with a split."""
    export(street.where(camera=PERSPECTIVE), "nerfstudio", out, ExportOptions(split="novel"))


def export_gsplat(street: Dataset, out: Path) -> None:
    """All cameras, undistorted."""
    export(street, "gsplat", out, ExportOptions(undistort=True))


EXPORTS = {
    "nuscenes_export": export_nuscenes,
    "nerfstudio_export": export_nerfstudio,
    "gsplat_export": export_gsplat,
}


def result(name: str) -> Any:
    """What a toolkit read."""
    return json.loads((RESULTS / name / "result.json").read_text())


def main(folder: Path) -> None:
    """Write all exports."""
    street = make_street(folder / "dataset")
    for name, write in EXPORTS.items():
        write(street, folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
