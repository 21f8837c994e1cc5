"""The part of docs/export.md that states what each format keeps and loses: ``python -m mirror.export.layouts_page``."""

from __future__ import annotations

from mirror.export.run import LAYOUTS, find_layout


def layouts_page() -> str:
    """Return the tables of all formats, as Markdown."""
    parts = []
    for name in LAYOUTS:
        layout = find_layout(name)
        rows = [f"| {kept.field} | {kept.place} | {kept.tolerance} |" for kept in layout.kept]
        table = ["| kept | where | largest difference |", "|---|---|---|", *rows]
        parts += [f"### {name}: {layout.title}", "", *table, "", f"Lost: {'; '.join(layout.lost)}.", ""]
    return "\n".join(parts)


if __name__ == "__main__":
    print(layouts_page())
