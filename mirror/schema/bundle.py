"""``bundle.json``: the files of a published dataset with their hashes, and the images that it withholds."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field

from mirror.schema.documents import Document, FileEntry, InnerPath

BUNDLE: Final = "bundle.json"
PUBLISHING: Final = ".publishing"
"""Empty file that stands in the folder of a bundle until its document is written."""


class Bundle(Document):
    """The contents of a published dataset.

    Attributes:
        format: always ``mirror-bundle``.
        version: version of this document's format.
        split: the split whose held-out images are withheld.
        protocols: names of the protocols whose truth is withheld.
        dataset_hash: hash of the split's data; results of other data are not comparable.
        licence: licence of the data, as an SPDX identifier or a name.
        files: size and SHA-256 of every other file, by path relative to the bundle.
        withheld: paths of the withheld images.
    """

    format: Literal["mirror-bundle"] = "mirror-bundle"
    version: Literal["1.0"] = "1.0"
    split: str
    protocols: tuple[str, ...]
    dataset_hash: str
    licence: str
    files: dict[InnerPath, FileEntry]
    withheld: tuple[str, ...] = Field(default=())
