"""The layers that one initialisation writes: which exist, and from which inputs they were made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mirror.dataset.derived_layer import DerivedLayer
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.unfinished_work import DEPTH, work_folder
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
        """The folder of unfinished work, kept until all layers are complete; other inputs use another folder."""
        return work_folder(self.layout, DEPTH, self.name, hash_values(dict(self.input_hashes)))

    def folder(self, traversal_id: str, kind: str) -> Path:
        """Return the folder of one layer."""
        return self.layout.layer(traversal_id, kind, self.source, self.version)

    def layer(self, traversal_id: str, kind: str) -> DerivedLayer:
        """Return one layer, which may be missing."""
        # The layers show images: after a redaction they are layers of other inputs.
        return DerivedLayer(
            self.layout, traversal_id, kind, self.source, self.version, self.input_hashes,
            "the same training traversals, redacted images, options and estimator", frozenset(),
            "make a layer of another name with mirror depth --version NAME, or, unless its images were redacted since,"
            f" use this layer with mirror reconstruct --initialise {self.name}",
        )  # fmt: skip

    def has(self, traversal_id: str, kind: str) -> bool:
        """Return whether a layer is complete.

        Raises:
            DatasetError: it is complete, and was made from other inputs.
        """
        return self.layer(traversal_id, kind).exists()

    def is_complete(self, traversal_id: str) -> bool:
        """Return whether a traversal has all layers."""
        return all(self.has(traversal_id, kind) for kind in self.kinds)

    def writer(self, traversal_id: str, kind: str) -> LayerWriter | None:
        """Open a writer of a layer; None if the layer is complete or its kind is not written."""
        if kind not in self.kinds or self.has(traversal_id, kind):
            return None
        return self.layer(traversal_id, kind).open()
