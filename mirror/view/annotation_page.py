"""A page of the frames of a layer of boxes in a given order, with the boxes drawn over the images."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.pages.rendering import render_page
from mirror.schema.files import write_bytes
from mirror.view.images import legend, rig_images


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
    frames, categories = [], set()
    for traversal_id, timestamp_ns, caption in rows:
        view = dataset.where(traversal=traversal_id, time=(timestamp_ns, timestamp_ns + 1))
        for number, frame in enumerate(view.frames()[:1]):
            other = None if against is None else view.with_layers(boxes=against).frames()[number]
            categories |= set(frame.boxes().category)
            categories |= set() if other is None else set(other.boxes().category)
            about = {"traversal_id": traversal_id, "frame_index": frame.frame_index, "caption": caption}
            frames.append({**about, "images": rig_images(frame, boxes=True, width_px=width_px, against=other)})
    page = render_page(
        "mirror.view",
        "annotation.html",
        title=title,
        note=note,
        boxes=str(dataset.layers.boxes),
        against=against,
        legend=legend(sorted(categories)),
        frames=frames,
    )
    write_bytes(out, page.encode())
    return len(frames)
