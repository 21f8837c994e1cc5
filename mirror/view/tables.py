"""Tables of the report: traversals, splits and the ledger."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any, Final

from mirror.html import html_table
from mirror.schema.documents import SplitDocument
from mirror.view.times import longitude_of, solar_time, utc

_MAX_ROWS: Final = 200
_RULES: Final = {
    "min_duration": ("time inside too short", "s"),
    "min_path": ("path inside too short", "m"),
    "min_overlap": ("too much of the path outside", ""),
}


def traversal_table(traversals: Sequence[Mapping[str, Any]]) -> str:
    """Format the table of traversals."""
    head = ["scene", "entry (UTC)", "solar time", "light", "weather", "vehicle"]
    head += ["n:duration", "n:path", "n:mean speed", "n:images"]
    rows = [
        (
            escape(row["scene_id"]),
            utc(row["entry_ns"]),
            solar_time(row["entry_ns"], longitude_of(row)),
            f'<i class="dot {escape(row["light"])}"></i>{escape(row["light"])}',
            escape(row["weather"]),
            f"{escape(row['vehicle_id'])} ({escape(row['vehicle_type'])})",
            f"{row['duration_s']:.1f} s",
            f"{row['path_m']:.0f} m",
            f"{row['mean_speed_mps']:.1f} m/s",
            f"{row['images']:,}" if row["has_images"] else "poses only",
        )
        for row in traversals
    ]
    return html_table(head, rows)


def split_table(split: SplitDocument, traversals: Sequence[Mapping[str, Any]]) -> str:
    """Format the traversals of each scene with their roles in a split."""
    parameters = split.parameters.model_dump(exclude_none=True)
    words = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in parameters.items())
    rows = []
    for scene in dict.fromkeys(row["scene_id"] for row in traversals):
        chips = []
        for row in traversals:
            if row["scene_id"] == scene:
                role = str(split.assignments.get(row["traversal_id"], "unknown"))
                why = split.left_out.get(row["traversal_id"], row["traversal_id"])
                about = f"{role.replace('_', ' ')} <small>{row['light']}, {row['weather']}</small>"
                chips.append(
                    f'<span class="chip {role}" title="{escape(why)}"><i class="dot {row["light"]}"></i>{about}</span>'
                )
        rows.append((escape(scene), f'<div class="chips">{"".join(chips)}</div>'))
    note = f'<p class="dim">{escape(words)}, seed {split.seed}; frozen: traversals that come later change nothing.</p>'
    return f"<h3>{escape(split.name)}</h3>{note}{html_table(['scene', 'traversals'], rows)}"


def ledger(passes: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Format the refused passes, each with the rule that refused it."""
    refused = [row for row in passes if row["decision"] == "refused"]
    yield (
        f"<p>{len(passes)} passes of a vehicle through a region of interest: {len(passes) - len(refused)} became "
        f"traversals, {len(refused)} did not.</p>"
    )
    if not refused:
        return
    head = "scene,drive,entry (UTC),refused because,n:measured,n:required,n:duration,n:path,n:overlap,start and end"
    rows = []
    for row in refused[:_MAX_ROWS]:
        words, unit = _RULES[row["rule"]]
        part = " (part of a split pass)" if row["split"] else ""
        rows.append(
            (
                escape(row["scene_id"]),
                escape(row["drive_id"]),
                utc(row["entry_ns"]),
                f"{words}{part} <small>{row['rule']}</small>",
                f"{row['measured']:.3g} {unit}",
                f"{row['threshold']:g} {unit}",
                f"{row['duration_s']:.1f} s",
                f"{row['path_m']:.1f} m",
                f"{100 * row['overlap']:.1f} %",
                f"{escape(row['entry_kind'].replace('_', ' '))}, {escape(row['exit_kind'].replace('_', ' '))}",
            )
        )
    yield html_table(head.split(","), rows)
    if len(refused) > _MAX_ROWS:
        yield f'<p class="dim">The first {_MAX_ROWS} of {len(refused)}; all are in index/passes.parquet.</p>'
