"""What a scorer reads: renders, their truth, pixels that are scored, weights. Made anew in each worker process."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.check import MAX_TABLE_BYTES
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.untrusted import UntrustedFiles, open_untrusted
from mirror.protocols.document import Protocol
from mirror.protocols.png import decode_render, max_png_bytes
from mirror.protocols.rectangle import Rectangle
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.view import RenderView
from mirror.weights.resolve import WeightResolver


@dataclass(frozen=True)
class ScoringInputs:
    """Everything that scoring reads.

    Attributes:
        protocol: how it is scored.
        submission: folder or zip.
        manifest: of the submission.
        dataset: the truth.
        layers: of masks and boxes, by traversal.
        hidden: folder of hidden truth; None: the dataset's own pictures.
        resolver: finds weights.
        unavailable: metrics that cannot be had, and how to get them.
        stand_ins: other metrics that can be had in their place, under their own names.
        features: folder of cached features.
        extractor: of edited regions, and its argument.
        measured: an installed method and the folder of its model, whose speed is measured; None: none is.
    """

    protocol: Protocol
    submission: Path
    manifest: SubmissionManifest
    dataset: Dataset
    layers: Mapping[str, tuple[str, ...]]
    hidden: Path | None
    resolver: WeightResolver
    unavailable: Mapping[str, str]
    stand_ins: tuple[str, ...]
    features: Path
    extractor: str = "diff-grabcut"
    measured: tuple[str, Path] | None = None
    made: dict[str, object] = field(default_factory=dict, compare=False, repr=False)

    def __getstate__(self) -> dict[str, object]:
        """Without what was made here: networks are loaded where they are used."""
        return {**{key: value for key, value in vars(self).items() if key not in ("files", "truth")}, "made": {}}

    @cached_property
    def files(self) -> UntrustedFiles:
        """The submission's files."""
        return open_untrusted(self.submission)

    @cached_property
    def truth(self) -> GroundTruth:
        """The truth."""
        return GroundTruth(self.dataset, self.protocol, dict(self.layers), self.hidden)

    def render(self, view: RenderView) -> UInt8:
        """A render's pixels (H, W, 3), RGB.

        Raises:
            UntrustedError: it cannot be read.
            RenderError: it is broken or of another size.
        """
        data = self.files.read(view.path, max_png_bytes(view.width_px, view.height_px))
        return decode_render(data, view.width_px, view.height_px, view.path)

    def scored_mask(self, view: RenderView) -> Bool:
        """The pixels (H, W) that are scored: the protocol's, but those that the method was fitted to."""
        scored = self.truth.scored_mask(view)
        for part in self.manifest.appearance.held_out_pixels:
            scored[_slices(part, *scored.shape)] = False
        return scored

    def fingerprint(self, path: str) -> str:
        """SHA-256 of a file of the submission."""
        return hashlib.sha256(self.files.read(path, MAX_TABLE_BYTES)).hexdigest()


def _slices(part: Rectangle, height: int, width: int) -> tuple[slice, slice]:
    """All pixels that a rectangle touches."""
    rows = slice(int(np.floor(part.top * height)), int(np.ceil(part.bottom * height)))
    return rows, slice(int(np.floor(part.left * width)), int(np.ceil(part.right * width)))
