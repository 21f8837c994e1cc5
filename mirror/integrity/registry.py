"""The registry of all rules; rules are selected by id or group."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pkgutil import walk_packages

from mirror.errors import UsageError
from mirror.integrity import rules as package
from mirror.integrity.finding import Cost
from mirror.integrity.rule import Rule, declared


@cache
def rules() -> dict[str, Rule]:
    """Return all rules by id, sorted."""
    for module in walk_packages(package.__path__, f"{package.__name__}."):
        import_module(module.name)
    return declared()


def select_rules(only: Iterable[str] = (), skip: Iterable[str] = (), cost: Cost = Cost.FILES) -> list[Rule]:
    """Select the rules to run.

    Args:
        only: ids, or letters of groups; these run whatever they cost. Empty: all rules up to ``cost``.
        skip: ids, or letters of groups, that do not run.
        cost: the most expensive kind of rule that runs.

    Raises:
        UsageError: a rule or group does not exist.
    """
    wanted, unwanted = _named(only), _named(skip)
    chosen = [rule for rule in rules().values() if rule.rule_id in wanted or (not wanted and rule.cost <= cost)]
    return [rule for rule in chosen if rule.rule_id not in unwanted]


def _named(names: Iterable[str]) -> set[str]:
    found: set[str] = set()
    for name in names:
        own = {rule.rule_id for rule in rules().values() if name.upper() in (rule.rule_id, rule.group)}
        if not own:
            near = difflib.get_close_matches(name.upper(), rules(), n=1, cutoff=0.0)
            raise UsageError(
                f"there is no rule {name!r}",
                expected=f"an id such as {near[0]}, or a group such as {near[0].rstrip('0123456789')}",
                remedy="docs/rules.md lists all rules",
            )
        found |= own
    return found
