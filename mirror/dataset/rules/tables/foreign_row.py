"""TAB006."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rows import Rows
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("TAB006", Severity.ERROR, remedy="write the table again with its own drive, vehicle, source and version")
def foreign_row(view: SceneView) -> Iterator[Finding]:
    """A calibration names another drive or vehicle, or a layer's row another source or version, than its folder's."""
    calibrations = view.all_calibrations
    for name in ("drive_id", "vehicle_id"):
        expected = [getattr(view.traversals[number].drive, name) for _, number, _ in calibrations.parts]
        yield from _differing(calibrations, name, expected)
    for rows in (view.boxes, view.masks, view.depth, view.points):
        folders = [file.split("/")[-2] for file in rows.files]
        yield from _differing(rows, "source", [folder.partition("@")[0] for folder in folders])
        yield from _differing(rows, "source_version", [folder.partition("@")[2] for folder in folders])


def _differing(rows: Rows, name: str, expected: list[str]) -> Iterator[Finding]:
    codes, words = rows.words(name)
    position = {word: code for code, word in enumerate(words)}
    wanted = np.array([position.get(word, -1) for word in expected], np.int64)[rows.owner]
    yield from rows.findings(
        codes != wanted, lambda row: f"{name} is {rows.word(name, row)!r}; expected {expected[rows.owner[row]]!r}"
    )
