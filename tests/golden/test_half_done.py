"""Work that an earlier version left half done is finished, not begun again."""

from __future__ import annotations

import json
from pathlib import Path

from mirror.dataset.migration import migrate
from mirror.integrity import check
from tests.golden.half_done import RECORD, finish, layer_inputs, unpack


def test_unfinished_work_of_an_earlier_version_is_finished(tmp_path: Path) -> None:
    root = unpack(tmp_path)
    migrate(root)
    # Of the second drive, one frame was annotated and none described; of the first, all four and three.
    assert finish(root) == {"annotate": (2, 2), "describe": (3, 4), "track": (1, 1), "masks": (1, 1)}
    assert layer_inputs(root) == json.loads(RECORD.read_text())
    assert not check(root, only=["IDX"]).findings
    # Nothing is left to do.
    assert [done for _, done in finish(root).values()] == [0, 0, 0, 0]
