"""The inputs of later verbs that a dataset lacks: lenses, boxes, masks and points."""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa

from mirror.counting import count_of
from mirror.dataset.dataset import Dataset

_LENS_NEEDED_BY = ("calibrate check", "annotate", "reconstruct", "export")
_BOXES_NEEDED_BY = ("reconstruct", "dataset publish", "submission new", "generate", "export")
_MASKS_NEEDED_BY = ("reconstruct", "evaluate")
_POINTS_NEEDED_BY = ("reconstruct", "export")


@dataclass(frozen=True)
class Missing:
    """An input that a dataset, or a part of it, lacks.

    Attributes:
        name: ``lens``, ``boxes``, ``masks`` or ``points``.
        where: the part of the dataset that lacks it, in words.
        needed_by: verbs that need it.
        remedy: the verb that makes it, and the way to do without it.
    """

    name: str
    where: str
    needed_by: tuple[str, ...]
    remedy: str

    def __str__(self) -> str:
        verbs = ", ".join(f"`mirror {verb}`" for verb in self.needed_by)
        return f"no {self.name}: {self.where}; needed by {verbs}; {self.remedy}"


def find_missing(dataset: Dataset) -> list[Missing]:
    """Find the inputs of later verbs that the traversals of a view lack. No image is opened.

    Args:
        dataset: the view.

    Returns:
        One item for each input that at least one camera or traversal lacks, in the order in which they are made.
    """
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    kinds = [{layer.partition("/")[0] for layer in row["layers"]} for row in rows]
    missing = [*_find_missing_lenses(dataset)]
    for name, needed_by, remedy in (
        (
            "boxes",
            _BOXES_NEEDED_BY,
            "`mirror annotate` takes those of a file, a program or a network: docs/annotation/detectors.md shows a"
            " program of ten lines. No network for real images comes with MIRROR. `--no-masks` does without boxes"
            " and masks",
        ),
        ("masks", _MASKS_NEEDED_BY, "not needed where there are boxes; `mirror annotate masks` makes them of boxes"),
        (
            "points",
            _POINTS_NEEDED_BY,
            "`mirror reconstruct` estimates them by itself, `mirror depth` before an export",
        ),
    ):
        without = sum(name not in own for own in kinds)
        # Masks are a second source of road users' pixels beside boxes.
        if without and not (name == "masks" and all("boxes" in own for own in kinds)):
            where = f"{without} of {count_of(len(rows), 'traversal')}"
            missing.append(Missing(name, where, needed_by, remedy))
    return missing


def _find_missing_lenses(dataset: Dataset) -> list[Missing]:
    calibrated = _pairs(dataset.table("calibrations", ["traversal_id", "camera"]))
    without = sorted({camera for _, camera in _pairs(dataset.table("images", ["traversal_id", "camera"])) - calibrated})
    if not without:
        return []
    remedy = (
        "`mirror calibrate intrinsics` finds one from images of a board and writes it into the recording; then"
        " `mirror ingest --replace`"
    )
    return [Missing("lens", f"camera {', '.join(without)}", _LENS_NEEDED_BY, remedy)]


def _pairs(table: pa.Table) -> set[tuple[str, str]]:
    """The different pairs of traversal and camera. One batch is one traversal, or a part of one."""
    pairs: set[tuple[str, str]] = set()
    for batch in table.to_batches():
        # `Table.group_by` would import pandas.
        codes = [batch.column(name).dictionary_encode() for name in ("traversal_id", "camera")]
        indices = zip(*(column.indices.to_numpy(zero_copy_only=False) for column in codes))
        names = [column.dictionary.to_pylist() for column in codes]
        pairs |= {(names[0][one], names[1][two]) for one, two in set(indices)}
    return pairs
