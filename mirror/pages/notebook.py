"""Objects in notebooks: what ``_repr_html_`` of datasets, frames, results and metrics shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from mirror.arrays import UInt8
from mirror.pages.images import inline_image
from mirror.pages.rendering import render_part

_THUMB_PX: Final = 160
_PACKAGE: Final = "mirror.pages"


@dataclass(frozen=True)
class Thumbnail:
    """An image of a strip.

    Attributes:
        name: text below it.
        image: (H, W, 3), RGB; None: it cannot be shown.
        problem: why it cannot be shown.
    """

    name: str
    image: UInt8 | None
    problem: str = ""


def show_summary(title: str, shots: Iterable[Thumbnail], facts: Iterable[tuple[str, object]]) -> str:
    """Format an object as HTML: a strip of thumbnails and a table of its facts; all text is escaped.

    Args:
        title: the object's name.
        shots: the images; wider ones are scaled down to 160 px.
        facts: names and values.
    """
    inlined = [
        (shot.name, None if shot.image is None else inline_image(shot.image, shot.name, _THUMB_PX), shot.problem)
        for shot in shots
    ]
    return str(render_part(_PACKAGE, "notebook.html", "summary", title, inlined, list(facts)))


def show_rows(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format rows as an HTML table below a title; all text is escaped."""
    return str(render_part(_PACKAGE, "notebook.html", "rows", title, head, list(rows)))
