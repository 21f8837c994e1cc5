"""The images that a published dataset does not contain, because submissions are scored against them."""

from __future__ import annotations

from mirror.dataset.store import Store
from mirror.schema.bundle import BUNDLE, Bundle
from mirror.schema.files import parse_json


def read_withheld(store: Store) -> frozenset[str]:
    """Read the paths of the images that a published dataset withholds; empty for a complete dataset.

    Raises:
        SchemaError: ``bundle.json`` is invalid.
    """
    found = store.read_many([BUNDLE])
    if BUNDLE not in found:
        return frozenset()
    return frozenset(parse_json(found[BUNDLE], Bundle, store.full_path(BUNDLE)).withheld)


def image_remedy(store: Store, uri: str) -> str:
    """Return the remedy for an image that cannot be read."""
    if uri in read_withheld(store):
        return "leave the image out: the dataset is a published one, and only its organiser has this image"
    return "restore the file, or `mirror ingest RECORDING... --replace` from the recording"
