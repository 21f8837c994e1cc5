"""Checking a dataset against integrity rules."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.integrity.finding import Cost as Cost
    from mirror.integrity.finding import Finding as Finding
    from mirror.integrity.finding import Severity as Severity
    from mirror.integrity.run import CheckReport as CheckReport
    from mirror.integrity.run import check as check

__all__ = ["CheckReport", "Cost", "Finding", "Severity", "check"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "CheckReport": "mirror.integrity.run",
        "Cost": "mirror.integrity.finding",
        "Finding": "mirror.integrity.finding",
        "Severity": "mirror.integrity.finding",
        "check": "mirror.integrity.run",
    },
)
