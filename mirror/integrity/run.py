"""Running the integrity rules on a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mirror.dataset.index.table_copy import local_tables
from mirror.errors import ExitCode, MirrorError
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.registry import select_rules
from mirror.integrity.rule import Findings, Rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.links import refuse_links_out

_ORDER = tuple(Severity)


@dataclass(frozen=True)
class CheckReport:
    """The result of a check.

    Attributes:
        rules: the rules that ran.
        findings: rules with their findings: errors first, then sorted by rule, file and place.
        unreadable: errors of unreadable files that no finding names, because no rule for them ran.
    """

    rules: Sequence[Rule]
    findings: Sequence[tuple[Rule, Finding]]
    unreadable: Sequence[MirrorError]

    def counts(self) -> dict[str, int]:
        """Return the number of findings by severity."""
        found = Counter(rule.severity.value for rule, _ in self.findings)
        return {severity.value: found[severity.value] for severity in _ORDER}

    def exit_code(self, *, strict: bool = False) -> ExitCode:
        """Return the exit code of `mirror check`.

        Args:
            strict: count warnings as errors.
        """
        failing = {Severity.ERROR, Severity.WARNING} if strict else {Severity.ERROR}
        if any(rule.severity in failing for rule, _ in self.findings):
            return ExitCode.FINDINGS
        return ExitCode.COULD_NOT_RUN if self.unreadable else ExitCode.DONE


def check(
    root: str | Path,
    *,
    only: Iterable[str] = (),
    skip: Iterable[str] = (),
    cost: Cost = Cost.FILES,
    start: Callable[[int], object] = lambda scenes: None,
    advance: Callable[[int], object] = lambda scenes: None,
) -> CheckReport:
    """Check a dataset against the integrity rules. Nothing is written.

    Tables are read one scene at a time, so that memory does not grow with the number of scenes. Each image is opened
    once for all rules.

    Args:
        root: the dataset's folder or URL. Of a URL, documents and tables are copied to this machine first.
        only: ids of rules, or letters of groups; these run whatever they cost. Empty: all rules up to ``cost``.
        skip: ids of rules, or letters of groups, that do not run.
        cost: the most expensive kind of rule that runs.
        start: called with the number of scenes.
        advance: called with the number of scenes done since the last call.

    Raises:
        DatasetError: the folder holds no dataset, or a link in it leads out of it.
        UsageError: a rule or group does not exist.

    Example:
        >>> report = mirror.check("dataset", only=["IMG001"])
        >>> [rule.rule_id for rule in report.rules], report.counts()["error"]
        (['IMG001'], 0)
    """
    rules = select_rules(only, skip, cost)
    with local_tables(root) as copy:
        refuse_links_out(copy.layout.root)
        report = _check(DatasetView.of_copy(copy), rules, start, advance)
        for error in report.unreadable:
            error.file = None if error.file is None else copy.name(error.file)
        return report


def _check(
    view: DatasetView, rules: Sequence[Rule], start: Callable[[int], object], advance: Callable[[int], object]
) -> CheckReport:
    layout = view.layout
    findings: list[tuple[Rule, Finding]] = []

    def collect(rule: Rule, run: Callable[[], Findings], file: str, place: str | None = None) -> None:
        # An invalid number makes derived values NaN, and NaN compares as false. Separate rules find invalid numbers.
        with np.errstate(all="ignore"):
            try:
                findings.extend((rule, finding) for finding in run())
            except Exception as error:  # noqa: BLE001
                # A rule that fails on some data must not end the check: the failure is reported as an error.
                problem = f"the rule cannot be evaluated on this data ({type(error).__name__}: {error})"
                findings.append((replace(rule, severity=Severity.ERROR), Finding(file, place, problem)))

    document, rois = view.name(layout.document), view.name(layout.rois)
    for rule in rules:
        if rule.of_dataset is not None:
            collect(rule, partial(rule.of_dataset, view), document)
    of_scene = [rule for rule in rules if rule.of_scene is not None]
    scenes = list(view.scenes.values()) if of_scene else []
    start(len(scenes))
    for scene in scenes:
        scene_view = SceneView(view, scene)
        for rule in of_scene:
            if rule.of_scene is not None:
                run = partial(rule.of_scene, scene_view)
                collect(rule, run, rois, f"scene {scene.scene_id}")
        advance(1)
    findings.sort(key=lambda hit: (_ORDER.index(hit[0].severity), hit[0].rule_id, hit[1].file, hit[1].place or ""))
    named = {finding.file for _, finding in findings}
    unreadable = [error for file, error in sorted(view.problems.items()) if file not in named]
    return CheckReport(rules, findings, unreadable)
