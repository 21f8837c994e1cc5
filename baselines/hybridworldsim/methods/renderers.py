"""Trained blocks of any method, ready to render."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import TypeAdapter

from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.training.appearance import FITTED, MEAN, SWEEP, AppearanceSelector
from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.run.folder import MODEL, Run, read_run
from hybridworldsim.training.run.parameters import read_parameters, set_parameters
from hybridworldsim.training.run.previews import pixels
from hybridworldsim.training.trainable_method import Rendering, TrainableMethod
from hybridworldsim.training.viewpoint import Source, to_viewpoint
from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.views.view import RenderView


class Renderer(Protocol):
    """Renders views of a trained model."""

    def __call__(self, view: RenderView) -> UInt8:
        """(H, W, 3) of a view."""
        ...

    def render(self, view: RenderView) -> Rendering:
        """A view with its depth."""
        ...


@dataclass(frozen=True, eq=False)
class OpenBlock:
    """A block and what renders it."""

    run: Run
    trainer: TrainableMethod


def open_block(folder: Path, make: Callable[[InitialGeometry, Any], TrainableMethod], settings: type) -> OpenBlock:
    """Read a trained block.

    Args:
        folder: of its run.
        make: of the method.
        settings: class of its settings.

    Raises:
        DatasetError: the model is missing or another method's.
    """
    run = read_run(folder)
    trainer = make(_placeholder(run), TypeAdapter(settings).validate_python(run.settings))
    set_parameters(trainer.model, read_parameters(folder / MODEL))
    return OpenBlock(run, trainer)


class NearestBlockRenderer:
    """Renders views by the block that the camera is nearest to.

    Args:
        blocks: at least one.
        appearance: how images look that were not trained on. Methods without latents know the looks that were trained
            on and nothing between them.

    Raises:
        UsageError: the policy needs latents.
    """

    def __init__(self, blocks: Sequence[OpenBlock], appearance: AppearancePolicy) -> None:
        if appearance.policy in (FITTED, MEAN) or appearance.policy.startswith(SWEEP):
            raise UsageError(
                f"{appearance.policy!r}, but {blocks[0].run.method} has no latents to fit or to mix",
                place="--appearance", expected="nearest, or one that is given",
            )  # fmt: skip
        self._blocks = list(blocks)
        lines = DrivenLines([source for one in blocks for source in one.run.sources], appearance.views)
        self._looks = [
            AppearanceSelector(one.run.sources, appearance.policy, appearance.views, appearance.everywhere, lines)
            for one in blocks
        ]
        self._centres = np.array([one.run.origin_m[:2] for one in blocks])

    def __call__(self, view: RenderView) -> UInt8:
        """(H, W, 3) of a view."""
        return pixels(self.render(view).rgb)

    def render(self, view: RenderView) -> Rendering:
        """A view with its depth."""
        here = view.pose.translation[0, :2]
        place = int(np.abs(self._centres - here).max(axis=1).argmin())
        block = self._blocks[place]
        look = self._looks[place].select(view)
        ((source, _),) = look.colours
        viewpoint = to_viewpoint(view, np.array(block.run.origin_m)).with_source(source)
        return block.trainer.render(viewpoint)


def _placeholder(run: Run) -> InitialGeometry:
    """Something of the right kinds to make a model of: all its rows are replaced."""
    flat: Float64 = np.zeros((1, 3))

    def ground(places: Float64) -> tuple[Float64, Float64]:
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    sources = [Source(one.traversal_id, one.camera) for one in run.sources]
    return InitialGeometry(flat, np.empty((0, 3)), flat, ground, run.radius_m, sources, np.zeros((1, 3), np.uint8))
