"""Findings of rules, their severity, and the cost of a rule."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum


class Severity(StrEnum):
    """Severity of a finding: with an error the dataset is wrong, with a warning doubtful; info is only a note."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Cost(IntEnum):
    """The amount that a rule reads: tables and documents; sizes and ends of files; all bytes, with decoded images."""

    TABLES = 0
    FILES = 1
    IMAGES = 2


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
