"""Holding a dataset against the integrity rules of `mirror.dataset.rules`."""

from __future__ import annotations

from mirror.dataset.check.rule import Cost as Cost
from mirror.dataset.check.rule import Severity as Severity
from mirror.dataset.check.run import CheckReport as CheckReport
from mirror.dataset.check.run import check as check
