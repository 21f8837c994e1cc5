"""Inputs of a scorer: renders, their truth, masks of scored pixels, weights. Each worker process opens its own."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.devices import CPU
from mirror.evaluation.submission.check import MAX_TABLE_BYTES
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.untrusted import UntrustedError, UntrustedFiles, open_untrusted
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
        protocol: the protocol to score by.
        submission: folder or zip of the submission.
        manifest: manifest of the submission.
        dataset: dataset with the truth.
        hashes: SHA-256 of the checked files of the submission, by path.
        layers: names of the layers of masks and boxes, by traversal.
        hidden: folder of hidden truth; None: the truth is the dataset's images.
        resolver: finds weights.
        unavailable: unavailable metrics, each with its remedy.
        stand_ins: metrics that are computed in place of unavailable ones, under their own names.
        features: folder of cached features.
        extractor: extractor of edited regions, with its argument.
        measured: a method (name or ``FILE.py:OBJECT``) and the folder of its model, to measure its speed; None: not.
        device: where networks run, as torch names it.
        made: objects made in this process by name, such as networks; they are not pickled.
    """

    protocol: Protocol
    submission: Path
    manifest: SubmissionManifest
    dataset: Dataset
    hashes: Mapping[str, str]
    layers: Mapping[str, tuple[str, ...]]
    hidden: Path | None
    resolver: WeightResolver
    unavailable: Mapping[str, str]
    stand_ins: tuple[str, ...]
    features: Path
    extractor: str = "diff-grabcut"
    measured: tuple[str, Path] | None = None
    device: str = CPU
    made: dict[str, object] = field(default_factory=dict, compare=False, repr=False)

    def __getstate__(self) -> dict[str, object]:
        """Return the state without open files and loaded networks: each process opens and loads its own."""
        return {
            **{key: value for key, value in vars(self).items() if key not in ("files", "truth", "recorded")},
            "made": {},
        }

    @cached_property
    def files(self) -> UntrustedFiles:
        """Files of the submission."""
        return open_untrusted(self.submission)

    @cached_property
    def truth(self) -> GroundTruth:
        """Truth of the views."""
        return GroundTruth(self.dataset, self.protocol, dict(self.layers), self.hidden)

    @cached_property
    def recorded(self) -> GroundTruth:
        """The recorded images of the views, also where hidden truth is given."""
        return GroundTruth(self.dataset, self.protocol, dict(self.layers))

    def render(self, view: RenderView) -> UInt8:
        """Read a render's pixels (H, W, 3), RGB.

        Raises:
            UntrustedError: the render cannot be read.
            RenderError: the render is broken or has a wrong size.
        """
        data = self.read(view.path, max_png_bytes(view.width_px, view.height_px))
        return decode_render(data, view.width_px, view.height_px, view.path)

    @property
    def fitted_part(self) -> Rectangle | None:
        """The part of every image that is not scored because the method's appearance was fitted to it."""
        return self.protocol.fitted_part if self.manifest.appearance.policy == "fitted" else None

    def scored_mask(self, view: RenderView) -> Bool:
        """Return the mask (H, W) of scored pixels: the protocol's mask without pixels that the method was fitted to."""
        scored = self.truth.scored_mask(view)
        part = self.fitted_part
        if part is not None:
            scored[part.touched(*scored.shape)] = False
        return scored

    def read(self, path: str, max_bytes: int = MAX_TABLE_BYTES) -> bytes:
        """Read a file of the submission, with the bytes that were checked and hashed before the scoring.

        Raises:
            UntrustedError: the file cannot be read, or was changed after the check.
        """
        data = self.files.read(path, max_bytes)
        if hashlib.sha256(data).hexdigest() != self.hashes.get(path):
            raise UntrustedError(
                "was changed while the submission was evaluated",
                file=f"{self.files.where}: {path}",
                remedy="evaluate a copy that nobody writes to",
            )
        return data
