"""Records of the study: one JSON line for each finished stage and for each rollout.

Lines are only ever appended, so that the file can be committed at any time and continued on another machine, and
processes that run different stages can share it. The last line of a stage or of a rollout counts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mirror.errors import UsageError
from mirror.schema.json_lines import LineReader, append_line, decode_object

Figures = dict[str, Any]


@dataclass(frozen=True, order=True)
class RolloutKey:
    """The key of a rollout: policy, scenario, seed and world.

    Attributes:
        world: the world.
        policy: the policy.
        scenario: the scenario.
        seed: its seed.
    """

    world: str
    policy: str
    scenario: str
    seed: int


class Records:
    """The records of one declaration in a file.

    Args:
        file: the file; it need not exist.
        declaration: hash of the declaration.

    Raises:
        UsageError: the file has records of another declaration.
        DatasetError: a line is no record.
    """

    def __init__(self, file: Path, declaration: str) -> None:
        self.file, self._declaration = file, declaration
        self.stages: dict[str, Figures] = {}
        self.core_s = 0.0
        self.rollouts: dict[RolloutKey, Figures] = {}
        self._reader = LineReader(file, decode_object)
        self.refresh()

    def refresh(self) -> None:
        """Read the lines that were appended to the file since the last call, also by other processes.

        Raises:
            UsageError: a line is of another declaration.
            DatasetError: a line is no record.
        """
        for number, line in self._reader.read():
            if line.get("declaration") != self._declaration:
                raise UsageError(
                    f"made under the declaration {str(line.get('declaration'))[:12]}, not {self._declaration[:12]}",
                    file=self.file, place=f"line {number}", remedy="choose another --outcomes",
                )  # fmt: skip
            self._take(line)

    def add_stage(self, name: str, core_s: float, figures: Mapping[str, Any]) -> None:
        """Append a finished stage."""
        self._append({"stage": name, "core_s": round(core_s, 1), "figures": dict(figures)})

    def add_rollout(self, key: RolloutKey, row: Mapping[str, Any]) -> None:
        """Append a rollout."""
        self._append({**vars(key), **row})

    def withdraw(self, key: RolloutKey, reason: str) -> None:
        """Append that a rollout does not count although no hash shows its fault; its cost stays."""
        nothing = dict.fromkeys(("network", "model", "scale"))
        self._append({**vars(key), "core_s": 0.0, **nothing, "withdrawn": reason})

    def _append(self, line: Mapping[str, Any]) -> None:
        append_line(self.file, json.dumps({"declaration": self._declaration, **line}, allow_nan=False))
        self.refresh()

    def _take(self, line: Figures) -> None:
        self.core_s += float(line["core_s"])
        if "stage" in line:
            self.stages[line["stage"]] = line["figures"]
        else:
            names = RolloutKey.__dataclass_fields__
            key = RolloutKey(**{name: line[name] for name in names})
            self.rollouts[key] = {name: value for name, value in line.items() if name not in names}
