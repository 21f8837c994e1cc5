"""Tables on a page: traversals, splits and the ledger."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any, Final

from mirror.html import html_table
from mirror.schema.documents import SplitDocument
from mirror.view.images import utc

_ROWS: Final = 200
_RULES: Final = {
    "min_duration": ("inside too briefly", "s"),
    "min_path": ("driven too little", "m"),
    "min_overlap": ("too much of the way outside", ""),
}


def traversal_table(traversals: Sequence[Mapping[str, Any]]) -> str:
    """One row a traversal."""
    head = ["scene", "entry (UTC)", "light", "weather", "vehicle", "n:duration", "n:path", "n:mean speed", "n:images"]
    rows = [
        (
            escape(one["scene_id"]),
            utc(one["entry_ns"]),
            f'<i class="dot {escape(one["light"])}"></i>{escape(one["light"])}',
            escape(one["weather"]),
            f"{escape(one['vehicle_id'])} ({escape(one['vehicle_type'])})",
            f"{one['duration_s']:.1f} s",
            f"{one['path_m']:.0f} m",
            f"{one['mean_speed_mps']:.1f} m/s",
            f"{one['images']:,}" if one["has_images"] else "poses only",
        )
        for one in traversals
    ]
    return html_table(head, rows)


def split_table(split: SplitDocument, traversals: Sequence[Mapping[str, Any]]) -> str:
    """Each scene's traversals as chips that carry their roles."""
    parameters = split.parameters.model_dump(exclude_none=True)
    words = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in parameters.items())
    rows = []
    for scene in dict.fromkeys(one["scene_id"] for one in traversals):
        chips = []
        for one in traversals:
            if one["scene_id"] == scene:
                role = str(split.assignments.get(one["traversal_id"], "unknown"))
                why = split.left_out.get(one["traversal_id"], one["traversal_id"])
                about = f"{role.replace('_', ' ')} <small>{one['light']}, {one['weather']}</small>"
                chips.append(
                    f'<span class="chip {role}" title="{escape(why)}"><i class="dot {one["light"]}"></i>{about}</span>'
                )
        rows.append((escape(scene), f'<div class="chips">{"".join(chips)}</div>'))
    note = f'<p class="dim">{escape(words)}, seed {split.seed}; frozen: traversals that come later change nothing.</p>'
    return f"<h3>{escape(split.name)}</h3>{note}{html_table(['scene', 'traversals'], rows)}"


def ledger(passes: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Every refused pass with the rule that refused it, in words."""
    refused = [one for one in passes if one["decision"] == "refused"]
    yield (
        f"<p>{len(passes)} passes of a vehicle through a region of interest: {len(passes) - len(refused)} became "
        f"traversals, {len(refused)} did not.</p>"
    )
    if not refused:
        return
    head = (
        "scene,drive,entry (UTC),refused because,n:measured,n:asked for,n:duration,n:path,n:overlap,began and ended by"
    )
    rows = []
    for one in refused[:_ROWS]:
        words, unit = _RULES[one["rule"]]
        part = " (part of a split pass)" if one["split"] else ""
        rows.append(
            (
                escape(one["scene_id"]),
                escape(one["drive_id"]),
                utc(one["entry_ns"]),
                f"{words}{part} <small>{one['rule']}</small>",
                f"{one['measured']:.3g} {unit}",
                f"{one['threshold']:g} {unit}",
                f"{one['duration_s']:.1f} s",
                f"{one['path_m']:.1f} m",
                f"{100 * one['overlap']:.1f} %",
                f"{escape(one['entry_kind'].replace('_', ' '))}, {escape(one['exit_kind'].replace('_', ' '))}",
            )
        )
    yield html_table(head.split(","), rows)
    if len(refused) > _ROWS:
        yield f'<p class="dim">The first {_ROWS} of {len(refused)}; all are in index/passes.parquet.</p>'
