"""Rows of a table by key, against scans of the table; and frames that search in place of a scan."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.dataset.index import build_index
from mirror.dataset.row_index import RowIndex
from mirror.schema.tables import BOXES, MASKS
from tests.builders.dataset import EPOCH, Builder, Pass, box, mask_row


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_rows_and_neighbours_are_those_of_a_scan(kind: type) -> None:
    rng = np.random.default_rng(0)
    for count in (0, 1, 2, 50):
        values = rng.integers(-10, 10, count).astype(kind)
        index = RowIndex(values)
        instants = np.unique(values)
        assert index.distinct.tolist() == instants.tolist()
        assert index.step == (np.median(np.diff(instants)) if len(instants) > 1 else 0.0)
        for value in range(-14, 14):
            assert index.rows(value).tolist() == np.flatnonzero(values == value).tolist()
            nearest = int(instants[np.argmin(np.abs(instants - value))]) if count else None
            assert index.nearest(value) == nearest


def test_tables_are_scanned_for_the_first_frame_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a", frames=6)])
    stamps = [EPOCH + step * 100_000_000 for step in range(6)]
    # Rows of an instant are not neighbours, and null velocities have their own conversion.
    rows = [box(stamp, name, vx_mps=None) for name in ("one", "two") for stamp in stamps[::-1]]
    builder.layer(traversal, "boxes", "petr@1", BOXES, rows)
    kinds = [(stamp, kind) for kind in ("dynamic", "sky") for stamp in stamps]
    masks = [mask_row("front_wide", stamp, f"traversals/{traversal}/x.png", kind=kind) for stamp, kind in kinds]
    builder.layer(traversal, "masks", "sam@1", MASKS, masks)
    build_index(tmp_path)
    frames = list(mirror.open(tmp_path).frames())

    def contents(number: int) -> tuple[object, ...]:
        frame = frames[number]
        image = frame.images["front_wide"]
        return list(frame.images), frame.boxes().track_id, [mask.kind for mask in image.masks()]

    expected = (list(builder.cameras), ("one", "two"), ["dynamic", "sky"])
    assert contents(0) == expected
    calls: Counter[str] = Counter()
    for name in ("unique", "flatnonzero", "argsort"):

        def count(*args: object, name: str = name, call: object = getattr(np, name), **options: object) -> object:
            calls[name] += 1
            return call(*args, **options)

        monkeypatch.setattr(np, name, count)
    assert all(contents(number) == expected for number in range(1, 6))
    assert not calls
