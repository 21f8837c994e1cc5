"""Sheets of images: the test clips as recorded, without road users, and as each model generated them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.studies.generation.study import Study
from benchmarks.studies.tiles import sheet
from hybridworldsim.generation.clips.clip import Clip
from mirror.arrays import UInt8
from mirror.schema.files import write_bytes

_CLIPS: Final = 4
_COLUMNS: Final = 8
_NAME_PX: Final = 140


def write_sheets(study: Study, out: Path) -> list[Path]:
    """Write a sheet for each of the first test clips: one row for each source and view, one column for each instant."""
    written = []
    for clip in study.test[:_CLIPS]:
        path = out / f"{clip.clip_id}.png"
        image = draw_sheet(study, clip, list_rolled_out(study), range(len(clip.views)), _COLUMNS)
        write_bytes(path, cv2.imencode(".png", image[..., ::-1])[1].tobytes())
        written.append(path)
    return written


def list_rolled_out(study: Study) -> list[str]:
    """Return names of the models that were rolled out, without those that only chose the teacher's number of steps."""
    paths = sorted(path for path in (study.folder / "rollouts").glob("*") if path.is_dir())
    return [path.name for path in paths if not path.name.startswith("teacher-")]


def draw_sheet(study: Study, clip: Clip, models: Sequence[str], views: Sequence[int], columns: int) -> UInt8:
    """Draw a sheet of one clip: images at their size, each under the number of its frame.

    Args:
        study: the study.
        clip: a test clip.
        models: names of models; those that were not rolled out over this clip are left out.
        views: numbers of the views.
        columns: number of instants, evenly over the rollout.
    """
    sources = {"recorded": clip.images[study.references :], "without road users": clip.background[study.references :]}
    for name in models:
        file = study.folder / "rollouts" / name / f"{clip.clip_id}.npz"
        if file.is_file():
            with np.load(file) as stored:
                sources[name] = stored["images"]
    frames = np.linspace(0, len(clip) - study.references - 1, columns).astype(int)
    rows = [
        [("", _write_name((name, clip.views[view]), images.shape[2])), *(
            (str(frame), images[frame, view]) for frame in frames
        )]
        for name, images in sources.items()
        for view in views
    ]  # fmt: skip
    return sheet(rows)


def _write_name(lines: Sequence[str], height_px: int) -> UInt8:
    """Write the name of a row beside it: images are shown at their size, which is too narrow for it."""
    tile = np.full((height_px, _NAME_PX, 3), 255, np.uint8)
    for number, line in enumerate(lines):
        cv2.putText(tile, line, (2, 14 + 16 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return tile
