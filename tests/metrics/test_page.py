"""The Python of docs/metrics.md and of its pages runs as it stands."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.conftest import ROOT

pytest.importorskip("torch")


def test_the_page_s_code_runs_and_tensors_score_as_arrays() -> None:
    names: dict[str, Any] = {}
    pages = [ROOT / "docs" / "metrics.md", *sorted((ROOT / "docs" / "metrics").glob("*.md"))]
    blocks = re.findall(r"```python\n(.*?)```", "\n".join(page.read_text() for page in pages), re.DOTALL)
    assert len(blocks) == 4
    for code in blocks[:2]:
        exec(code, names)
    expected = names["ssim"](names["render"], names["truth"], mask=names["mask"])
    assert names["scores"] == [expected, expected]
    assert names["metric"].compute().images.n == 3
    for code in blocks[2:]:
        exec(code, names)
