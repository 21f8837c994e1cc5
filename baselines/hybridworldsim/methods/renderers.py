"""Renderers of trained blocks, for any method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from torch import Tensor

from hybridworldsim.methods.overrides import settings_adapter
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.trainable.method import CoverRenderableModel, RenderableModel, Rendering
from hybridworldsim.trainable.viewpoint import Source, Viewpoint, to_viewpoint
from hybridworldsim.training.appearance import FITTED, MEAN, SWEEP, AppearanceSelector
from hybridworldsim.training.documents import Run, read_run
from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.parameters import read_parameters, set_parameters
from hybridworldsim.training.previews import pixels
from hybridworldsim.training.run.folder import MODEL
from mirror.arrays import Float32, Float64, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities
from mirror.protocols.views.view import RenderView


class BlockRenderer(Protocol):
    """A renderer of the views of a trained model."""

    def __call__(self, view: RenderView) -> UInt8:
        """Render the pixels (H, W, 3) of a view."""
        ...

    def render(self, view: RenderView) -> Rendering:
        """Render a view with its depth."""
        ...


@dataclass(frozen=True, eq=False)
class OpenBlock:
    """A block and the model that renders it."""

    run: Run
    model: RenderableModel


def open_block(
    folder: Path, make_empty: Callable[[Run, Any], RenderableModel], settings: type, device: str = CPU
) -> OpenBlock:
    """Read a trained block.

    Args:
        folder: folder of the block's run.
        make_empty: makes a model of a run and its settings; the model's parameters are replaced by the trained ones.
        settings: class of the method's settings.
        device: where it renders.

    Raises:
        DatasetError: the model is missing or belongs to another method.
    """
    run = read_run(folder)
    opened = make_empty(run, settings_adapter(settings).validate_python(run.settings))
    set_parameters(opened.model, read_parameters(folder / MODEL))
    if device != CPU:
        opened.model.to(device)
    return OpenBlock(run, opened)


def training_sources(run: Run) -> list[Source]:
    """Return the traversals and cameras that a run trains on."""
    return [Source(camera.traversal_id, camera.camera) for camera in run.sources]


def one_point(run: Run) -> InitialGeometry:
    """Return a geometry of one point, for a method that makes its models from a geometry only."""
    point: Float64 = np.zeros((1, 3))

    def ground(places: Float64) -> tuple[Float64, Float64]:
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    colours = np.zeros((1, 3), np.uint8)
    return InitialGeometry(point, np.empty((0, 3)), point, ground, run.radius_m, training_sources(run), colours)


class NearestBlockRenderer:
    """A renderer of each view by the block that is nearest to its camera.

    Args:
        blocks: at least one block.
        appearance: policy for untrained traversals and cameras. A method without latents has the trained appearances
            only and cannot mix them.

    Raises:
        UsageError: the policy needs latents.
    """

    def __init__(self, blocks: Sequence[OpenBlock], appearance: AppearancePolicy) -> None:
        if appearance.policy in (FITTED, MEAN) or appearance.policy.startswith(SWEEP):
            raise UsageError(
                f"{appearance.policy!r}, but {blocks[0].run.method} has no latents to fit or to mix",
                place="--appearance", expected="nearest, or the name of a traversal, light or weather",
            )  # fmt: skip
        self._blocks = list(blocks)
        lines = DrivenLines([source for block in blocks for source in block.run.sources], appearance.views)
        self._selectors = [
            AppearanceSelector(block.run.sources, appearance.policy, appearance.views, appearance.everywhere, lines)
            for block in blocks
        ]
        self._centres = np.array([block.run.origin_m[:2] for block in blocks])

    def __call__(self, view: RenderView) -> UInt8:
        """Render the pixels (H, W, 3) of a view."""
        return pixels(self.render(view).rgb)

    def render(self, view: RenderView) -> Rendering:
        """Render a view with its depth."""
        model, viewpoint = self.choose(view)
        return model.render(viewpoint)

    def choose(self, view: RenderView) -> tuple[RenderableModel, Viewpoint]:
        """Return the nearest block's model, and the view in its frame and appearance."""
        camera_m = view.pose.translation[0, :2]
        place = int(np.abs(self._centres - camera_m).max(axis=1).argmin())
        block = self._blocks[place]
        choice = self._selectors[place].select(view)
        ((source, _),) = choice.colours
        return block.model, to_viewpoint(view, np.array(block.run.origin_m)).with_source(source)


class NearestBlockCoverRenderer(NearestBlockRenderer):
    """A `NearestBlockRenderer` that also returns the covered share of each pixel."""

    def render_covers(self, view: RenderView, limit_m: Float32) -> tuple[Rendering, Tensor]:
        """Render a view, and return the share (H, W) of each pixel that the street nearer than a depth covers.

        Args:
            view: the view.
            limit_m: (H, W) depth (camera z) of each pixel; 0 or less: nothing is before it.
        """
        model, viewpoint = self.choose(view)
        return cast(CoverRenderableModel, model).render_covers(viewpoint, limit_m)


def render_nearest(
    blocks: Sequence[OpenBlock], appearance: AppearancePolicy, capabilities: Capabilities
) -> NearestBlockRenderer:
    """Make a `NearestBlockRenderer`, with `render_covers` if the capabilities state it."""
    return (NearestBlockCoverRenderer if capabilities.renders_covers else NearestBlockRenderer)(blocks, appearance)
