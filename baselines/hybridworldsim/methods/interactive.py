"""Renders a street for a moving camera: what is decoded for one place serves the next ones nearby.

Decoding takes four fifths of the time of an image at 480 x 270. While the camera moves, the Gaussians that were decoded
for a wider image are drawn again until the camera has moved `_REUSE_M` or turned `_REUSE_RAD`; their colours and
opacities then have the viewing direction of that earlier place. An image of a
camera at rest is always decoded for its own place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from torch import Tensor

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition, Decoded
from hybridworldsim.model.street import StreetModel
from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.documents import TrainedCamera
from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.previews import pixels
from mirror.arrays import UInt8
from mirror.devices import CPU
from mirror.methods.interactive import TrainedAppearance
from mirror.protocols.views.view import RenderView

_REUSE_M: Final = 2.5
_REUSE_RAD: Final = 0.12
_WIDER: Final = 1.4
"""Size of the image that is decoded for, in units of the image that is drawn."""


@dataclass(frozen=True, eq=False)
class _Kept:
    """Gaussians of an earlier image."""

    decoded: Decoded
    view: RenderView
    weights: Mapping[str, float]


class InteractiveStreet:
    """An `mirror.methods.interactive.InteractiveRenderer` of trained blocks.

    Args:
        blocks: each block with its street, and the traversals and cameras that it was trained on.
        device: where it renders.
    """

    def __init__(self, blocks: Sequence[tuple[Block, StreetModel, Sequence[TrainedCamera]]], device: str = CPU) -> None:
        self._composition = Composition([(block, street) for block, street, _ in blocks], device)
        self._cameras = [camera for _, _, cameras in blocks for camera in cameras]
        self._lines = DrivenLines(self._cameras, ())
        self._kept: _Kept | None = None

    @property
    def appearances(self) -> tuple[TrainedAppearance, ...]:
        """The trained traversals, whose appearances can be mixed."""
        found = {
            camera.traversal_id: TrainedAppearance(camera.traversal_id, camera.light, camera.weather)
            for camera in self._cameras
        }
        return tuple(found[name] for name in sorted(found))

    def render(self, view: RenderView, weights: Mapping[str, float], *, moving: bool) -> UInt8:
        """See `mirror.methods.interactive.InteractiveRenderer`."""
        kept = self._kept
        if not moving or kept is None or not _is_near(kept, view, weights):
            drawn = _wider(view) if moving else view
            decoded = self._composition.decode(drawn, lambda latents: self._latents(latents, view, weights))
            kept = self._kept = _Kept(decoded, view, dict(weights))
        return pixels(self._composition.draw(view, kept.decoded).rgb)

    def _latents(
        self, appearance: AppearanceLatents, view: RenderView, weights: Mapping[str, float]
    ) -> tuple[Tensor, Tensor]:
        """The latents of a mixture for the camera's colours, and those of its heaviest part for the content."""
        sources = {source.traversal_id: source for source in appearance.sources if source.camera == view.camera}
        for source in appearance.sources:
            sources.setdefault(source.traversal_id, source)
        known = {name: weight for name, weight in weights.items() if name in sources and weight > 0.0}
        if not known:
            nearest = self._lines.nearest(view, sorted(sources))
            known = {nearest: 1.0}
        total = sum(known.values())
        colours = [appearance(sources[name]) * (weight / total) for name, weight in known.items()]
        heaviest: Source = sources[max(known, key=lambda name: known[name])]
        return sum(colours[1:], colours[0]), appearance(heaviest)


def _is_near(kept: _Kept, view: RenderView, weights: Mapping[str, float]) -> bool:
    before = kept.view
    same = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "camera")
    if any(getattr(before, name) != getattr(view, name) for name in same) or dict(weights) != kept.weights:
        return False
    twist = (before.pose.inverse() @ view.pose).log()[0]
    return bool(np.linalg.norm(twist[:3]) < _REUSE_RAD and np.linalg.norm(twist[3:]) < _REUSE_M)


def _wider(view: RenderView) -> RenderView:
    width, height = round(view.width_px * _WIDER), round(view.height_px * _WIDER)
    return view.model_copy(
        update={
            "width_px": width,
            "height_px": height,
            "cx_px": view.cx_px + 0.5 * (width - view.width_px),
            "cy_px": view.cy_px + 0.5 * (height - view.height_px),
        }
    )
