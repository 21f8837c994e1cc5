"""Rows of the report's tables: traversals, splits and the ledger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from mirror.dataset.times import longitude_of, solar_time, utc
from mirror.schema.documents import SplitDocument

_MAX_ROWS: Final = 200
_RULES: Final = {
    "min_duration": ("time inside too short", "s"),
    "min_path": ("path inside too short", "m"),
    "min_overlap": ("too much of the path outside", ""),
}


def traversal_rows(traversals: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Add the times of entry to the rows of traversals."""
    return [
        {**row, "entry": utc(row["entry_ns"]), "solar": solar_time(row["entry_ns"], longitude_of(row))}
        for row in traversals
    ]


def describe_split(split: SplitDocument, traversals: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Describe a split: name, parameters, seed, and the traversals of each scene with their roles."""
    parameters = split.parameters.model_dump(exclude_none=True)
    scenes: dict[str, list[dict[str, Any]]] = {}
    for row in traversals:
        name = row["traversal_id"]
        role, why = split.assignments.get(name, "unknown"), split.left_out.get(name, name)
        about = {"role": str(role), "why": why, "light": row["light"], "weather": row["weather"]}
        scenes.setdefault(row["scene_id"], []).append(about)
    return {
        "name": split.name,
        "parameters": ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in parameters.items()),
        "seed": split.seed,
        "scenes": [{"name": scene, "traversals": own} for scene, own in scenes.items()],
    }


def ledger_rows(passes: Sequence[Mapping[str, Any]]) -> tuple[int, list[dict[str, Any]]]:
    """Return the number of refused passes, and the first ones, each with the rule that refused it in words."""
    refused = [row for row in passes if row["decision"] == "refused"]
    rows = []
    for row in refused[:_MAX_ROWS]:
        because, unit = _RULES[row["rule"]]
        rows.append({**row, "entry": utc(row["entry_ns"]), "because": because, "unit": unit})
    return len(refused), rows
