"""A layer that is made once, from stated inputs: the same inputs keep it, other inputs are refused."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.layer_writer import RECORDED, LayerWriter
from mirror.dataset.layout import MANIFEST, Layout, read_manifest
from mirror.dataset.redaction import REDACTION, current_redaction
from mirror.errors import DatasetError
from mirror.schema.documents import Manifest
from mirror.schema.files import read_json

ANOTHER_VERSION: Final = "give the new layer another version: --version NAME"


@dataclass(frozen=True)
class DerivedLayer:
    """One layer of one traversal, and the inputs that the layer is made from.

    A traversal has the layer, or it is missing, or it was made from other inputs. In the last case the layer stays, and
    the new one needs another version.

    Attributes:
        layout: the dataset.
        traversal_id: the traversal.
        kind: kind of the layer: the name of its parent folder.
        source: program that makes the layer.
        version: version of the source.
        inputs: hashes of the inputs, by name. The layer's manifest records them, with the hash of the recorded
            traversal and that of its redaction.
        described: the inputs in words, for messages, such as "the same boxes and options".
        not_compared: names of recorded hashes that do not decide. A layer that shows no pixels stays what it is when
            images are redacted later; other names are those of hashes that only the work yields.
        remedy: the way out, for messages.
    """

    layout: Layout
    traversal_id: str
    kind: str
    source: str
    version: str
    inputs: Mapping[str, str]
    described: str
    not_compared: frozenset[str] = frozenset({REDACTION})
    remedy: str = ANOTHER_VERSION

    @property
    def folder(self) -> Path:
        """The folder of the layer; it may be missing."""
        return self.layout.layer(self.traversal_id, self.kind, self.source, self.version)

    def exists(self) -> bool:
        """Return whether the traversal has the layer, made from these inputs.

        Raises:
            DatasetError: it has the layer, made from other inputs.
            SchemaError: a manifest is broken.
        """
        manifest = read_manifest(self.folder)
        if manifest is None:
            return False
        differing = self._find_differing(manifest.derived_from)
        if differing:
            raise DatasetError(
                "the layer was made from other inputs; no layer is replaced",
                file=self.folder,
                place=f"derived_from: {', '.join(differing)}",
                expected=self.described,
                remedy=self.remedy,
            )
        return True

    def open(self) -> LayerWriter:
        """Open a writer of the missing layer, which records the inputs.

        Raises:
            UsageError: the source or version is not valid in a folder's name.
            DatasetError: the traversal does not exist, or the layer exists already.
        """
        return LayerWriter(self.layout, self.traversal_id, self.kind, self.source, self.version, self.inputs)

    def _find_differing(self, before: Mapping[str, str]) -> list[str]:
        """List the names of hashes that were recorded with another value than they have now."""
        now: dict[str, str | None] = {**self.inputs}
        if RECORDED not in self.not_compared:
            now[RECORDED] = read_json(self.layout.recorded(self.traversal_id) / MANIFEST, Manifest).content
        if REDACTION not in self.not_compared:
            now[REDACTION] = current_redaction(self.layout, self.traversal_id)
        names = (before.keys() | now.keys()) - self.not_compared
        return sorted(name for name in names if before.get(name) != now.get(name))


def find_missing(layers: Iterable[DerivedLayer]) -> tuple[list[str], list[str]]:
    """Return the ids of traversals without the layer, and the ids of traversals with it.

    Raises:
        DatasetError: a traversal has the layer, made from other inputs.
    """
    missing: list[str] = []
    existing: list[str] = []
    for layer in layers:
        (existing if layer.exists() else missing).append(layer.traversal_id)
    return missing, existing
