"""Exports for other toolkits to read. ``python -m tests.peers NAME`` lets one read its export in an environment of its
own; the tests compare ``tests/peers/<name>/result.json`` with the dataset.
"""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from mirror.dataset.dataset import Dataset
from mirror.export.run import ExportOptions, export
from tests.builders.street import LENSES, make_street

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


def export_webdataset(street: Dataset, out: Path) -> None:
    """All cameras, distorted, with a split."""
    export(street, "webdataset", out, ExportOptions(split="novel"))


def export_lerobot(street: Dataset, out: Path) -> None:
    """All cameras, distorted."""
    export(street, "lerobot", out)


EXPORTS = {
    "nuscenes_export": export_nuscenes,
    "nerfstudio_export": export_nerfstudio,
    "gsplat_export": export_gsplat,
    "webdataset_export": export_webdataset,
    "lerobot_export": export_lerobot,
}


def _make_input(name: str, folder: Path) -> None:
    """Write the export that a toolkit reads, with its dataset beside it."""
    for old in (folder, folder.with_name("dataset")):
        shutil.rmtree(old, ignore_errors=True)
    EXPORTS[name](make_street(folder.with_name("dataset")), folder)


INPUTS = {name: partial(_make_input, name) for name in EXPORTS}
"""Writers of the folders that ``python -m tests.peers`` lets the toolkits read."""


def result(name: str) -> Any:
    """Return what a toolkit read."""
    return json.loads((RESULTS / name / "result.json").read_text())
