"""What a rule is, what it finds, and how it is declared."""

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
    "GEO": "places on the globe, and the world that hangs on them",
    "IDX": "the index, which is derived from everything else",
    "IMG": "images, their rows, files and pixels",
    "LED": "the ledgers of passes, accepted and refused",
    "MSK": "masks",
    "POS": "the ego poses of a traversal, recorded and in layers",
    "PTS": "points",
    "SPL": "splits, and what leaks through them",
    "TAB": "every table against its schema",
    "TIM": "stamps of images, frames and drives",
}
"""What the rules of each group look at."""

Findings: TypeAlias = Iterable[Finding]
DatasetCheck: TypeAlias = "Callable[[DatasetView], Findings]"
SceneCheck: TypeAlias = "Callable[[SceneView], Findings]"


@dataclass(frozen=True)
class Rule:
    """One integrity rule.

    Attributes:
        rule_id: three letters of the group, three digits.
        severity: how much a finding matters.
        cost: what has to be read.
        title: what is wrong where the rule finds something; one line.
        remedy: what to do then.
        of_dataset: looks at the dataset as a whole; None for a rule that looks at one scene at a time.
        of_scene: looks at one scene at a time; None for a rule that looks at the dataset as a whole.
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
        """The letters of its id."""
        return self.rule_id.rstrip("0123456789")


_declared: dict[str, Rule] = {}


def dataset_rule(
    rule_id: str, severity: Severity, *, title: str, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[DatasetCheck], DatasetCheck]:
    """Declare a function as a rule over the dataset."""

    def declare(check: DatasetCheck) -> DatasetCheck:
        _declare(Rule(rule_id, severity, cost, title, remedy, of_dataset=check))
        return check

    return declare


def scene_rule(
    rule_id: str, severity: Severity, *, title: str, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[SceneCheck], SceneCheck]:
    """Declare a function as a rule over one scene."""

    def declare(check: SceneCheck) -> SceneCheck:
        _declare(Rule(rule_id, severity, cost, title, remedy, of_scene=check))
        return check

    return declare


def declared() -> dict[str, Rule]:
    """All rules whose modules are imported, by id; `mirror.integrity.registry.rules` imports them all."""
    return dict(sorted(_declared.items()))


def _declare(rule: Rule) -> None:
    if rule.rule_id in _declared:
        raise ValueError(f"two rules have the id {rule.rule_id}")
    _declared[rule.rule_id] = rule
