"""docs/metrics.md runs as it stands."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.conftest import ROOT

pytest.importorskip("torch")


def test_the_page_s_code_runs_and_tensors_score_as_arrays() -> None:
    names: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "metrics.md").read_text(), re.DOTALL)
    assert len(blocks) == 4
    for code in blocks[:2]:
        exec(code, names)
    expected = names["ssim"](names["render"], names["truth"], mask=names["mask"])
    assert names["scores"] == [expected, expected]
    assert names["metric"].compute().images.n == 3
    for code in blocks[2:]:
        exec(code, names)
