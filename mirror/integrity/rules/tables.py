"""Rules of TAB: every table against its schema."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from mirror.arrays import Bool
from mirror.geometry.cameras import COEFFICIENTS
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rows import TableRows
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.recordings.calibration import STAGES, Calibration
from mirror.schema.tables import EGO_POSES


@scene_rule(
    "TAB001",
    Severity.ERROR,
    title=("A traversal's table cannot be read: cut short, of another schema version, a wrong column, or a null."),
    remedy="run the same `mirror ingest` again with --verify, or write the layer again",
)
def _unreadable_table(view: SceneView) -> Iterator[Finding]:
    view.tables()
    own = tuple(f"traversals/{item.traversal_id}/" for item in view.traversals)
    yield from report_unreadable(view.dataset.problems, lambda file: file.endswith(".parquet") and file.startswith(own))


@dataset_rule(
    "TAB002",
    Severity.ERROR,
    title="A ledger or the index's list of row groups cannot be read, as in TAB001.",
    remedy="run the same `mirror ingest` again with --verify; for index/: `mirror index --force`",
)
def _unreadable_ledger(view: DatasetView) -> Iterator[Finding]:
    _ = view.passes, view.index_row_groups
    yield from report_unreadable(
        view.problems, lambda file: file.endswith(".parquet") and file.startswith(("drives/", "index/"))
    )


@scene_rule(
    "TAB003",
    Severity.ERROR,
    title="Rows are not in the order that the table's schema states.",
    remedy="write the table again in the order that docs/schema.md states",
)
def _row_order(view: SceneView) -> Iterator[Finding]:
    for rows in view.tables():
        # The order of poses is their time, which is a rule of its own.
        if rows.table.name != EGO_POSES.name:
            yield from rows.findings(backward(rows), lambda row: "comes before the row above it")


def backward(rows: TableRows) -> Bool:
    """Mark the rows (N,) whose keys are smaller than the keys of the row above in the file; null has no order."""
    undecided = rows.same_file[1:].copy()
    smaller = np.zeros(len(rows), np.bool_)
    for values, known in rows.key_columns():
        both = undecided & known[1:] & known[:-1]
        smaller[1:] |= both & (values[1:] < values[:-1])
        undecided = both & (values[1:] == values[:-1])
    return smaller


@scene_rule(
    "TAB004",
    Severity.ERROR,
    title="Two rows of a file have the same keys: two images of one camera at one instant, one box twice.",
    remedy="take the repeated row out where it comes from, and write the table again",
)
def _repeated_key(view: SceneView) -> Iterator[Finding]:
    for rows in view.tables():
        if rows.table.name == EGO_POSES.name or not len(rows):
            continue
        keys = [rows.owner, *(column for pair in rows.key_columns() for column in pair)]
        order = np.lexsort(keys[::-1])
        same = np.all([key[order][1:] == key[order][:-1] for key in keys], axis=0)
        bad = np.zeros(len(rows), np.bool_)
        bad[order[1:][same]] = True
        yield from rows.findings(bad, lambda row: "the keys of another row")


VOCABULARY = {
    ("ego_poses", "orientation"): ("recorded", "course"),
    ("images", "codec"): ("jpeg", "png", "video"),
    ("images", "privacy"): ("raw", "redacted"),
    ("calibrations", "stage"): STAGES,
    ("calibrations", "model"): tuple(COEFFICIENTS),
    ("calibrations", "shutter_direction"): get_args(Calibration.model_fields["shutter_direction"].annotation),
    ("masks", "kind"): ("dynamic", "ego", "sky", "instance", "redaction"),
    ("points", "kind"): ("background", "ground", "far"),
}


@scene_rule(
    "TAB005",
    Severity.ERROR,
    title="A column holds a word that its schema does not know.",
    remedy="write the table again with the words that docs/schema.md lists",
)
def _unknown_word(view: SceneView) -> Iterator[Finding]:
    for rows in view.tables():
        for (table, name), known in VOCABULARY.items():
            if table == rows.table.name:
                codes, words = rows.text_codes(name)
                unknown = [code for code, word in enumerate(words) if word not in known]
                yield from rows.findings(
                    np.isin(codes, unknown),
                    lambda row, name=name, known=known, rows=rows: (  # type: ignore[misc]
                        f"{name} is {rows.text(name, row)!r}; expected {', '.join(known)}"
                    ),
                )


@scene_rule(
    "TAB006",
    Severity.ERROR,
    title=(
        "A calibration names another drive or vehicle, or a layer's row another source or version, than its folder's."
    ),
    remedy="write the table again with its own drive, vehicle, source and version",
)
def _foreign_row(view: SceneView) -> Iterator[Finding]:
    calibrations = view.all_calibrations
    for name in ("drive_id", "vehicle_id"):
        expected = [getattr(view.traversals[number].drive, name) for _, number, _ in calibrations.parts]
        yield from _differing(calibrations, name, expected)
    for rows in (view.boxes, view.masks, view.depth, view.points):
        folders = [file.split("/")[-2] for file in rows.files]
        yield from _differing(rows, "source", [folder.partition("@")[0] for folder in folders])
        yield from _differing(rows, "source_version", [folder.partition("@")[2] for folder in folders])


def _differing(rows: TableRows, name: str, expected: list[str]) -> Iterator[Finding]:
    codes, words = rows.text_codes(name)
    position = {word: code for code, word in enumerate(words)}
    wanted = np.array([position.get(word, -1) for word in expected], np.int64)[rows.owner]
    yield from rows.findings(
        codes != wanted, lambda row: f"{name} is {rows.text(name, row)!r}; expected {expected[rows.owner[row]]!r}"
    )
