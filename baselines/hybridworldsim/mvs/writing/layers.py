"""The layers that one initialisation writes: which exist, and from which inputs they were made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.redaction import REDACTION, current_redaction
from mirror.dataset.unfinished_work import DEPTH, work_folder
from mirror.errors import DatasetError
from mirror.schema.finished_work import hash_values


@dataclass(frozen=True)
class InitialisationLayers:
    """Layers of one source and version.

    Attributes:
        layout: paths of the dataset.
        source: source name of the layers.
        version: version of the source.
        kinds: kinds of layers that each traversal gets.
        input_hashes: hashes of all inputs, by name.
    """

    layout: Layout
    source: str
    version: str
    kinds: tuple[str, ...]
    input_hashes: Mapping[str, str]

    @property
    def name(self) -> str:
        """``source@version``."""
        return f"{self.source}@{self.version}"

    @property
    def work_folder(self) -> Path:
        """The folder of unfinished work, which is kept until all layers are complete; other inputs get another one."""
        return work_folder(self.layout, DEPTH, self.name, hash_values(dict(self.input_hashes)))

    def folder(self, traversal_id: str, kind: str) -> Path:
        """The folder of one layer."""
        return self.layout.layer(traversal_id, kind, self.source, self.version)

    def has(self, traversal_id: str, kind: str) -> bool:
        """Return whether a layer is complete.

        Raises:
            DatasetError: it is complete, and was made from other inputs.
        """
        manifest = read_manifest(self.folder(traversal_id, kind))
        if manifest is None:
            return False
        existing = {key: value for key, value in manifest.derived_from.items() if key not in ("recorded", REDACTION)}
        if manifest.derived_from.get(REDACTION) != current_redaction(self.layout, traversal_id):
            raise DatasetError(
                "the layer was made from images that have been redacted since",
                file=self.folder(traversal_id, kind),
                expected="a layer of the redacted images",
                remedy="make a layer of another name with mirror depth --version NAME",
            )
        if existing != self.input_hashes:
            differing = min(set(existing.items()) ^ set(self.input_hashes.items()))[0]
            raise DatasetError(
                f"the layer was made from other inputs: {differing} differs",
                file=self.folder(traversal_id, kind),
                expected="the same training traversals, options and estimator",
                remedy="make a layer of another name with mirror depth --version NAME, or use this layer with"
                f" mirror reconstruct --initialise {self.name}",
            )
        return True

    def is_complete(self, traversal_id: str) -> bool:
        """Return whether a traversal has all layers."""
        return all(self.has(traversal_id, kind) for kind in self.kinds)

    def writer(self, traversal_id: str, kind: str) -> LayerWriter | None:
        """Open a writer of a layer; None if the layer is complete or is not one of the kinds."""
        if kind not in self.kinds or self.has(traversal_id, kind):
            return None
        return LayerWriter(self.layout, traversal_id, kind, self.source, self.version)
