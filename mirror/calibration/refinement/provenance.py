"""What a refined calibration was made from: hashes of its inputs, as its layer records them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.errors import DatasetError
from mirror.schema.hashing import hash_document

_KINDS: Final = ("poses", "calibrations", "boxes", "masks")
OWN_KEYS: Final = ("recorded", REDACTION)
"""Keys that the writer of a layer adds."""


def hash_inputs(view: Dataset, settings: Mapping[str, Any]) -> dict[str, str]:
    """Hashes of everything that the refinement of one scene depends on, by name.

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


def has_layer(layout: Layout, traversal_id: str, source: str, version: str, inputs: Mapping[str, str]) -> bool:
    """Return whether a traversal has the layer already.

    Raises:
        DatasetError: it has, and it was made from other inputs.
    """
    folder = layout.layer(traversal_id, "calibrations", source, version)
    manifest = read_manifest(folder)
    if manifest is None:
        return False
    before = {key: value for key, value in manifest.derived_from.items() if key not in OWN_KEYS}
    if before != inputs:
        differing = min(set(before.items()) ^ set(inputs.items()))[0]
        raise DatasetError(
            f"the layer was made from other inputs: {differing} differs", file=folder,
            expected="the same traversals, layers and settings; no layer is replaced",
            remedy="give the new layer another version: --version NAME",
        )  # fmt: skip
    return True


def _input_layers(view: Dataset, traversal_id: str) -> list[tuple[str, str]]:
    """Kind and name of the layers of a traversal that are read: those chosen, all masks, and boxes if unambiguous."""
    there = [(kind, f"{source}@{version}") for kind, source, version in view.layout.layers(traversal_id)]
    chosen = {"poses": view.layers.poses, "calibrations": view.layers.calibrations, "boxes": view.layers.boxes}
    return [
        (kind, name)
        for kind, name in there
        if kind in _KINDS and (chosen.get(kind, name) or name) == name
    ]  # fmt: skip
