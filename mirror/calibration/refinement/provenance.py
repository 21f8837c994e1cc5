"""What a refined calibration was made from: hashes of its inputs, as its layer records them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.schema.hashing import hash_document

_KINDS: Final = ("poses", "calibrations", "boxes", "masks")


def hash_inputs(view: Dataset, settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the hashes of everything that the refinement of one scene depends on, by name.

    Args:
        view: the traversals that are refined together, with their layers chosen.
        settings: the settings; they become one hash.

    Raises:
        DatasetError: a folder is not complete.
    """
    hashes = {"settings": hash_document({**settings, "layers": asdict(view.layers)})}
    contents = ContentHashes(view.store)
    for traversal_id in view.traversals():
        layers = [f"{kind}/{name}" for kind, name in _input_layers(view, traversal_id)]
        redaction = newest_redaction(view.layout.layers(traversal_id))
        if redaction is not None:
            layers.append(f"{REDACTION}/{redaction[0]}@{redaction[1]}")
        hashes |= contents.traversal(traversal_id, layers)
    return hashes


def _input_layers(view: Dataset, traversal_id: str) -> list[tuple[str, str]]:
    """Kind and name of the layers of a traversal that are read: those chosen, all masks, and boxes if unambiguous."""
    there = [(kind, f"{source}@{version}") for kind, source, version in view.layout.layers(traversal_id)]
    chosen = {"poses": view.layers.poses, "calibrations": view.layers.calibrations, "boxes": view.layers.boxes}
    return [
        (kind, name)
        for kind, name in there
        if kind in _KINDS and (chosen.get(kind, name) or name) == name
    ]  # fmt: skip
