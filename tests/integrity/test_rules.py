"""Every rule finds what breaks it, and nothing in a dataset that is whole."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from mirror.integrity import Cost, check
from mirror.integrity.registry import rules
from tests.integrity import edits_of_files, edits_of_scenes
from tests.integrity.clean import Broken
from tests.integrity.edit import Edit

EDITS = [*edits_of_files.edits(), *edits_of_scenes.edits()]

OF_IMAGES = ("IMG", "PRV", "SPL")


def test_a_whole_dataset_has_no_findings(clean: Path) -> None:
    report = check(clean, cost=Cost.IMAGES)
    assert [(rule.rule_id, finding) for rule, finding in report.findings] == []
    assert report.unreadable == []
    assert report.exit_code(strict=True) == 0
    assert len(report.rules) == len(rules())


@pytest.mark.parametrize("edit", EDITS, ids=[f"{edit.rule}-{number}" for number, edit in enumerate(EDITS)])
def test_an_edit_triggers_its_rule(edit: Edit, broken: Broken) -> None:
    edit.change(broken)
    if edit.seal:
        broken.seal()
    # Rules that open images see what they saw in the whole dataset, unless the edit is of images.
    opens = edit.rule[:3] in OF_IMAGES or rules()[edit.rule].cost is Cost.IMAGES
    report = check(broken.root, cost=Cost.IMAGES if opens else Cost.FILES)
    found = {rule.rule_id for rule, _ in report.findings}
    listed = "\n".join(f"{rule.rule_id} {finding}" for rule, finding in report.findings)
    assert found == {edit.rule} | edit.also, listed
    if edit.file is not None:
        found = [finding.file for rule, finding in report.findings if rule.rule_id == edit.rule]
        assert any(fnmatchcase(file, edit.file) for file in found), listed


def test_every_rule_has_an_edit() -> None:
    assert {edit.rule for edit in EDITS} == set(rules())
