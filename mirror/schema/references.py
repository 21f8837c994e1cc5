"""The document of images that lie outside of a dataset: the tags that their stores gave to their bytes."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from mirror.schema.documents import Document
from mirror.schema.version import SCHEMA_VERSION

REFERENCES: Final = "references.json"
"""Name of the document in a traversal's recorded folder; without one, no tag is known."""


class ImageReferences(Document):
    """``traversals/<traversal_id>/recorded/references.json``: ETags of images elsewhere.

    Attributes:
        schema_version: version of the on-disk format.
        etags: by uri, without quotation marks.
    """

    schema_version: str = SCHEMA_VERSION
    etags: dict[str, str] = Field(default_factory=dict)
