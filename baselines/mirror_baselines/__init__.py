"""Baselines: floors that every method must beat, and methods of other papers."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command("benchmark", "write the submission of a floor, for comparison", "mirror_baselines.command")
