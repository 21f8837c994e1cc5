"""What a rule is, what it finds, and how it is declared."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from inspect import cleandoc
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from mirror.dataset.check.dataset_view import DatasetView
    from mirror.dataset.check.scene_view import SceneView


class Severity(StrEnum):
    """How much a finding matters: an error makes the dataset wrong, a warning doubtful; an info is worth knowing."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Cost(IntEnum):
    """What a rule has to read: tables and documents; the sizes and ends of files; all bytes, pictures decoded."""

    TABLES = 0
    FILES = 1
    PICTURES = 2


@dataclass(frozen=True)
class Finding:
    """One place that breaks a rule.

    Attributes:
        file: relative to the dataset's root.
        place: row, key or camera in it; the first, if there are several.
        message: what is wrong there, with the values.
        count: how many rows of the file are wrong.
    """

    file: str
    place: str | None
    message: str
    count: int = 1


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
        doc: what is wrong where the rule finds something; one line.
        remedy: what to do then.
        of_dataset: looks at the dataset as a whole; None for a rule that looks at one scene at a time.
        of_scene: looks at one scene at a time; None for a rule that looks at the dataset as a whole.
    """

    rule_id: str
    severity: Severity
    cost: Cost
    doc: str
    remedy: str
    of_dataset: DatasetCheck | None = None
    of_scene: SceneCheck | None = None

    @property
    def group(self) -> str:
        """The letters of its id."""
        return self.rule_id.rstrip("0123456789")


_declared: dict[str, Rule] = {}


def dataset_rule(
    rule_id: str, severity: Severity, *, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[DatasetCheck], DatasetCheck]:
    """Declare the function below as a rule over the dataset; the first line of its docstring says what is wrong."""

    def declare(check: DatasetCheck) -> DatasetCheck:
        _declare(Rule(rule_id, severity, cost, _first_line(check), remedy, of_dataset=check))
        return check

    return declare


def scene_rule(
    rule_id: str, severity: Severity, *, remedy: str, cost: Cost = Cost.TABLES
) -> Callable[[SceneCheck], SceneCheck]:
    """Declare the function below as a rule over one scene; the first line of its docstring says what is wrong."""

    def declare(check: SceneCheck) -> SceneCheck:
        _declare(Rule(rule_id, severity, cost, _first_line(check), remedy, of_scene=check))
        return check

    return declare


def declared() -> dict[str, Rule]:
    """All rules whose modules are imported, by id; `mirror.dataset.check.registry.rules` imports them all."""
    return dict(sorted(_declared.items()))


def _declare(rule: Rule) -> None:
    if rule.rule_id in _declared:
        raise ValueError(f"two rules have the id {rule.rule_id}")
    _declared[rule.rule_id] = rule


def _first_line(check: Callable[..., Findings]) -> str:
    return cleandoc(check.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
