"""A page of the frames of a layer of boxes in a given order, with the boxes drawn over the images."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.html import style_sheet
from mirror.schema.files import write_bytes
from mirror.view.images import legend, rig_images


def write_annotation_page(
    dataset: Dataset,
    rows: Iterable[tuple[str, int, str]],
    out: Path,
    *,
    title: str,
    note: str = "",
    width_px: int = 360,
) -> int:
    """Write a page that holds its images itself.

    Args:
        dataset: a view with one chosen layer of boxes.
        rows: traversal, timestamp and caption of each frame, in order.
        out: the HTML file.
        title: title of the page.
        note: a sentence below the title.
        width_px: wider images are scaled down.

    Returns:
        The number of frames on the page.

    Raises:
        DatasetError: the file cannot be written, or an image is broken.
    """
    sections, categories = [], set()
    for traversal_id, timestamp_ns, caption in rows:
        frames = dataset.where(traversal=traversal_id, time=(timestamp_ns, timestamp_ns + 1)).frames()
        for frame in frames[:1]:
            categories |= set(frame.boxes().category)
            head = f"<h2>{escape(traversal_id)}, frame {frame.frame_index}</h2><p>{escape(caption)}</p>"
            sections.append(head + rig_images(frame, boxes=True, width_px=width_px))
    write_bytes(out, _page(title, note, sections, sorted(categories)).encode())
    return len(sections)


def _page(title: str, note: str, sections: Sequence[str], categories: Sequence[str]) -> str:
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{style_sheet()}</style></head><body><main><h1>{escape(title)}</h1><p>{escape(note)}</p>{legend(categories)}"
        f"{''.join(sections)}</main></body></html>\n"
    )
