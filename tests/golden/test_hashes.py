"""Documents keep the hashes by which data that users have refers to them."""

from __future__ import annotations

import json
from pathlib import Path

from tests.golden.hashes import RECORD, list_hashes


def test_documents_keep_their_hashes_and_bytes(tmp_path: Path) -> None:
    known = json.loads(RECORD.read_text())
    found = list(list_hashes(tmp_path))
    assert dict(found) == known
    assert len(found) == len(known)
