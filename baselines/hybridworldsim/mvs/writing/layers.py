"""The layers that one initialisation writes: which are there, and what they were made of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, read_manifest
from mirror.errors import DatasetError

_WORK: Final = ".mvs"


@dataclass(frozen=True)
class InitialisationLayers:
    """Layers of one source and version.

    Attributes:
        layout: the dataset.
        source: who makes them.
        version: of the source.
        kinds: of layers that each traversal gets.
        made_of: hashes of what they are made of.
    """

    layout: Layout
    source: str
    version: str
    kinds: tuple[str, ...]
    made_of: Mapping[str, str]

    @property
    def name(self) -> str:
        """``source@version``."""
        return f"{self.source}@{self.version}"

    @property
    def work(self) -> Path:
        """Where unfinished work is kept until all layers are complete; other layers' work is elsewhere."""
        made_of = hashlib.sha256(json.dumps(dict(self.made_of), sort_keys=True).encode()).hexdigest()
        return self.layout.root / _WORK / f"{self.name}.{made_of[:16]}"

    def folder(self, traversal_id: str, kind: str) -> Path:
        """Of one layer."""
        return self.layout.layer(traversal_id, kind, self.source, self.version)

    def has(self, traversal_id: str, kind: str) -> bool:
        """Whether a layer is complete.

        Raises:
            DatasetError: it is, but was made of something else.
        """
        manifest = read_manifest(self.folder(traversal_id, kind))
        if manifest is None:
            return False
        there = {key: value for key, value in manifest.derived_from.items() if key != "recorded"}
        if there != self.made_of:
            differing = min(set(there.items()) ^ set(self.made_of.items()))[0]
            raise DatasetError(
                f"the layer was made of something else: {differing} differs",
                file=self.folder(traversal_id, kind),
                expected="the same training traversals, options and estimator",
                remedy="make one of another name, mirror depth --version NAME, or take this as it is:"
                f" mirror reconstruct --initialise {self.name}",
            )
        return True

    def complete(self, traversal_id: str) -> bool:
        """Whether a traversal has all of them."""
        return all(self.has(traversal_id, kind) for kind in self.kinds)

    def writer(self, traversal_id: str, kind: str) -> LayerWriter | None:
        """A writer of a layer; None: it is there, or not wanted."""
        if kind not in self.kinds or self.has(traversal_id, kind):
            return None
        return LayerWriter(self.layout, traversal_id, kind, self.source, self.version)
