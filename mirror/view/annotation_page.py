"""A page of the frames of a layer of boxes in a given order, with the boxes drawn over the images."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Final

from mirror.dataset.dataset import Dataset
from mirror.html import style_sheet
from mirror.schema.files import write_bytes
from mirror.view.images import legend, rig_images

_CSS: Final = ".against path{stroke-dasharray:5 4}svg.line{width:34px;height:10px;background:#333}"
_LINE: Final = (
    '<span><svg class="line boxes {kind}" viewBox="0 0 34 10"><path d="M0 5H34" class="c0"/></svg> {name}</span>'
)
_ORDER: Final = (
    "The worst frame comes first: boxes without a partner of their group within 2 m in the other layer, tracks that "
    "break within 25 m of the vehicle, a tenth of the doubt, and the shift, of which a tenth of the width counts as a "
    "box. Doubt is the sum of 1 - score over the boxes: 0 where the annotator is sure of each, or states no score."
)


def write_annotation_page(
    dataset: Dataset,
    rows: Iterable[tuple[str, int, str]],
    out: Path,
    *,
    title: str,
    note: str = "",
    against: str | None = None,
    width_px: int = 360,
) -> int:
    """Write a page that holds its images itself.

    Args:
        dataset: a view with one chosen layer of boxes.
        rows: traversal, timestamp and caption of each frame, in order.
        out: the HTML file.
        title: title of the page.
        note: a sentence below the title.
        against: a second layer of boxes, ``source@version``, drawn dashed below the first; None: none.
        width_px: wider images are scaled down.

    Returns:
        The number of frames on the page.

    Raises:
        DatasetError: the file cannot be written, or an image is broken.
    """
    sections, categories = [], set()
    for traversal_id, timestamp_ns, caption in rows:
        view = dataset.where(traversal=traversal_id, time=(timestamp_ns, timestamp_ns + 1))
        for number, frame in enumerate(view.frames()[:1]):
            other = None if against is None else view.with_layers(boxes=against).frames()[number]
            categories |= set(frame.boxes().category)
            categories |= set() if other is None else set(other.boxes().category)
            head = f"<h2>{escape(traversal_id)}, frame {frame.frame_index}</h2><p>{escape(caption)}</p>"
            sections.append(head + rig_images(frame, boxes=True, width_px=width_px, against=other))
    key = "" if against is None else _lines_key(str(dataset.layers.boxes), against)
    write_bytes(out, _page(title, note, key, sections, sorted(categories)).encode())
    return len(sections)


def _lines_key(solid: str, dashed: str) -> str:
    lines = (("", f"solid: {escape(solid)}"), ("against", f"dashed: {escape(dashed)}"))
    return f'<p class="key">{"".join(_LINE.format(kind=kind, name=name) for kind, name in lines)}</p>'


def _page(title: str, note: str, key: str, sections: Sequence[str], categories: Sequence[str]) -> str:
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{style_sheet()}{_CSS}</style></head><body><main><h1>{escape(title)}</h1><p>{escape(note)}</p>"
        f'<p class="dim">{_ORDER}</p>{key}{legend(categories)}'
        f"{''.join(sections)}</main></body></html>\n"
    )
