"""A suite of one short scenario on the tiny street, in place of `closed-loop-mini`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mirror.cli.main import main


def write_small_suite(capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    """Write small.toml in the current folder: one street, one start, a cut-in of one second.

    Returns:
        The word that it takes the place of, and its own, as `tests.tutorial_pages.follow` takes them.
    """
    assert main(["protocols", "show", "closed-loop-mini"]) == 0
    head, *blocks = re.split(r"^(?=\[)", capsys.readouterr().out, flags=re.M)
    street, start = (
        next(block for block in blocks if block.startswith(f"[[suite.{name}]]")) for name in ("streets", "starts")
    )
    rest = [block for block in blocks if not block.startswith("[[suite.")]
    at = [block.startswith("[suite]") for block in rest].index(True) + 1
    rest[at:at] = [re.sub(r'source = ".*?"', 'source = "synth:tiny:0:guangzhou-urban-01"', street), start]
    small = head + "".join(rest)
    small = small.replace('name = "closed-loop-mini"', 'name = "small"').replace("duration_s = 8.0", "duration_s = 1.0")
    names = small[small.index("scenarios = [") :].partition("\n")[0]
    Path("small.toml").write_text(small.replace(names, 'scenarios = ["cut-in"]'))
    return {"closed-loop-mini": ["small.toml"]}
