"""The definition and declaration of integrity rules."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from mirror.integrity.finding import Cost, Finding, Severity

if TYPE_CHECKING:
    from mirror.integrity.dataset_view import DatasetView
    from mirror.integrity.scene_view import SceneView


GROUPS: Final = {
    "BOX": "3D boxes",
    "CAM": "calibrations and rigs",
    "DEP": "depth maps",
    "DS": "the dataset's documents, folders and ids",
    "FIL": "the files that manifests list",
    "GEO": "geographic positions, and the world frame derived from them",
    "IDX": "the index, which is derived from all other files",
    "IMG": "images, their rows, files and pixels",
    "LED": "the ledgers of passes, accepted and refused",
    "LID": "references to lidar sweeps, whose files lie outside of the dataset",
    "MAP": "recorded road maps",
    "MSK": "masks",
    "POS": "the ego poses of a traversal, recorded and in layers",
    "PRV": "redacted images, and what was derived from images before they were redacted",
    "PTS": "points",
    "SPL": "splits and their leaks",
    "TAB": "every table against its schema",
    "TIM": "timestamps of images, frames and drives",
}
"""Subject of the rules of each group."""

Findings: TypeAlias = Iterable[Finding]
DatasetCheck: TypeAlias = "Callable[[DatasetView], Findings]"
SceneCheck: TypeAlias = "Callable[[SceneView], Findings]"


@dataclass(frozen=True)
class Rule:
    """One integrity rule: id, severity, cost, text and check.

    Attributes:
        rule_id: letters of the group and three digits.
        severity: severity of its findings.
        cost: what the rule has to read.
        title: the fault that the rule finds; one line.
        remedy: how to correct the fault.
        of_dataset: checks the complete dataset; None for a rule that checks one scene at a time.
        of_scene: checks one scene; None for a rule that checks the complete dataset.
    """

    rule_id: str
    severity: Severity
    cost: Cost
    title: str
    remedy: str
    of_dataset: DatasetCheck | None = None
    of_scene: SceneCheck | None = None

    @property
    def group(self) -> str:
        """The letters of the id."""
        return self.rule_id.rstrip("0123456789")


_declared: dict[str, Rule] = {}


def dataset_rule(
    rule_id: str, severity: Severity, *, title: str, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[DatasetCheck], DatasetCheck]:
    """Declare a function as a rule that checks the complete dataset."""

    def declare(check: DatasetCheck) -> DatasetCheck:
        _declare(Rule(rule_id, severity, cost, title, remedy, of_dataset=check))
        return check

    return declare


def scene_rule(
    rule_id: str, severity: Severity, *, title: str, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[SceneCheck], SceneCheck]:
    """Declare a function as a rule that checks one scene."""

    def declare(check: SceneCheck) -> SceneCheck:
        _declare(Rule(rule_id, severity, cost, title, remedy, of_scene=check))
        return check

    return declare


def declared() -> dict[str, Rule]:
    """Return the rules of the modules imported so far, by id; `mirror.integrity.registry.rules` imports all modules."""
    return dict(sorted(_declared.items()))


def _declare(rule: Rule) -> None:
    if rule.rule_id in _declared:
        raise ValueError(f"two rules have the id {rule.rule_id}")
    _declared[rule.rule_id] = rule
