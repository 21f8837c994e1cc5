"""Reading the document of a model from a folder that has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.errors import DatasetError
from mirror.methods.model_document import DOCUMENT, read_reconstruction


def test_a_folder_without_a_document(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=f"no {DOCUMENT}"):
        read_reconstruction(tmp_path)
    with pytest.raises(DatasetError, match="no such folder"):
        read_reconstruction(tmp_path / "absent")
