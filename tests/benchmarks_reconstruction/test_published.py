"""What docs/results.md says is what its outcomes come to."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks._reconstruction.arguments import Arguments
from benchmarks._reconstruction.declared import declared
from benchmarks._reconstruction.groups import groups
from benchmarks._reconstruction.verbs import VERBS

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
GROUPS = [name for name in groups(declared()) if name != "tuning"]


@pytest.mark.parametrize("verb", ["show", "truth"])
@pytest.mark.parametrize("group", GROUPS)
def test_tables_of_the_document_are_those_of_the_outcomes(
    verb: str, group: str, capsys: pytest.CaptureFixture[str]
) -> None:
    VERBS[verb](Arguments(verb, RESULTS, group=group), declared())
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    written = set(RESULTS.with_suffix(".md").read_text().splitlines())
    missing = [row for row in rows if row not in written]
    assert not missing, f"docs/results.md lacks what `{verb} --group {group}` prints: {missing[0]}"


def test_the_declaration_that_is_named_is_the_one_that_holds() -> None:
    assert declared().hash[:16] in (ROOT / "docs" / "results.md").read_text()
