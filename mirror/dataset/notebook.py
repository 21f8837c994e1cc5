"""Datasets and frames in notebooks, as HTML."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from mirror.dataset.image import Image
from mirror.dataset.times import utc
from mirror.errors import DatasetError
from mirror.pages.notebook import Thumbnail, show_summary

_MOST_SHOTS: Final = 6
_FRONT: Final = "front_wide"


def show_dataset(
    facts: Mapping[str, object],
    traversals: Sequence[Mapping[str, Any]],
    middle_images: Callable[[str], Mapping[str, Image]],
) -> str:
    """Format a dataset as HTML: the front image of one traversal a condition, and its contents.

    Args:
        facts: what it holds.
        traversals: rows of its traversals.
        middle_images: returns the images of the middle frame of a traversal, by camera.
    """
    chosen: dict[tuple[str, str], Mapping[str, Any]] = {}
    for row in traversals:
        if row["frames"]:
            chosen.setdefault((row["light"], row["weather"]), row)
    shots = []
    for (light, weather), row in sorted(chosen.items())[:_MOST_SHOTS]:
        images = middle_images(row["traversal_id"])
        camera = _FRONT if _FRONT in images else next(iter(images))
        shots.append(_take(images[camera], f"{row['scene_id']}, {light}, {weather}, {camera}"))
    more = {
        "conditions": "; ".join(sorted({f"{row['light']}, {row['weather']}" for row in traversals})),
        "time": f"{sum(row['duration_s'] for row in traversals) / 60:,.1f} min",
        "way": f"{sum(row['path_m'] for row in traversals) / 1000:,.2f} km",
    }
    return show_summary("Dataset", shots, [*facts.items(), *more.items()])


def show_frame(place: Mapping[str, object], timestamp_ns: int, images: Mapping[str, Image], boxes: str) -> str:
    """Format a frame as HTML: a thumbnail of each camera's image, and its place, time and boxes.

    Args:
        place: names of its scene, traversal and index.
        timestamp_ns: its time.
        images: its images by camera.
        boxes: its boxes in words.
    """
    shots = [_take(image, camera) for camera, image in images.items()]
    facts = [*place.items(), ("time", f"{utc(timestamp_ns)} UTC"), ("boxes", boxes)]
    return show_summary("Frame", shots, facts)


def _take(image: Image, name: str) -> Thumbnail:
    """Decode an image; one that cannot be read, such as a withheld one, is named instead of shown."""
    try:
        return Thumbnail(name, image.decode())
    except DatasetError as error:
        return Thumbnail(name, None, error.problem)
