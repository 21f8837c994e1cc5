"""A copy of the street of three lanes, and a protocol that is quickly scored."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import mirror
from mirror.dataset import Dataset
from mirror.protocols.document import Protocol, load_protocol


@pytest.fixture
def dataset(made_street: Path, tmp_path: Path) -> Dataset:
    return mirror.open(shutil.copytree(made_street, tmp_path / "dataset"))


@pytest.fixture
def protocol() -> Protocol:
    """Static reconstruction, scored by PSNR only."""
    plain = load_protocol("static-reconstruction").model_dump(mode="json")
    plain["metrics"] = [{"metric": "psnr"}]
    plain["ranking"] = {"metric": "psnr", "groups": ["novel"]}
    return Protocol.model_validate(json.loads(json.dumps(plain)))
