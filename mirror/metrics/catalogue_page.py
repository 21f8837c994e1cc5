"""Writes the table of all metrics into ``docs/metrics.md``: ``python -m mirror.metrics.catalogue_page [FILE]``."""

from __future__ import annotations

import math
from itertools import groupby
from typing import Final

from mirror.metrics.catalogue import MEASURES, PARTS, Kind, Measure
from mirror.schema.page_file import write_page

BEGIN: Final = "<!-- metrics: written by `python -m mirror.metrics.catalogue_page docs/metrics.md`; do not edit -->"
END: Final = "<!-- end of metrics -->"
_TITLES: Final[dict[Kind, str]] = {
    "image": "Of single images",
    "set": "Of sets of images or clips",
    "boxes": "Of detected boxes",
    "method": "Of methods, as their submissions state them",
    "rollout": "Of rollouts",
}


def format_tables() -> str:
    """Format one table for each kind of metrics, in Markdown."""
    whole = [measure for name, measure in MEASURES.items() if not name.endswith(tuple(f"_{part}" for part in PARTS))]
    whole.sort(key=lambda measure: list(_TITLES).index(measure.kind))
    lines = []
    for kind, measures in groupby(whole, key=lambda measure: measure.kind):
        lines += [f"### {_TITLES[kind]}", ""]
        lines += ["| metric | title | is | unit | better | values | weights |", "|---|---|---|---|---|---|---|"]
        lines += [_format_row(measure) for measure in measures]
        lines.append("")
        if kind == "image":
            words = "; ".join(f"`_{part}`, {about}" for part, about in PARTS.items())
            lines += [f"With a suffix, a metric is of a part of images whose vehicles are edited: {words}.", ""]
    return "\n".join(lines)


def fill_page(page: str) -> str:
    """Replace the part of a page between two marks by the tables.

    Raises:
        ValueError: the page has no marks.
    """
    before, _, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"no lines {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n\n{format_tables()}\n{END}{after}"


def _format_row(measure: Measure) -> str:
    low, high = (f"{bound:g}" if math.isfinite(bound) else "" for bound in (measure.low, measure.high))
    bounds = f"{low} to {high}" if low and high else f"from {low}" if low else "any"
    weights = ", ".join(f"`{name}`" for name in measure.needs)
    cells = (f"`{measure.name}`", measure.title, measure.about, measure.unit, measure.better, bounds, weights)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |"


if __name__ == "__main__":
    write_page("docs/metrics.md", __doc__, lambda file: fill_page(file.read_text()))
