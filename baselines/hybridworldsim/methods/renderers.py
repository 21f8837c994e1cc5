"""Trained blocks of any method, ready to render."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import TypeAdapter

from hybridworldsim.model.initialization import Initial
from hybridworldsim.training.appearance import FITTED, MEAN, SWEEP, AppearanceSelector
from hybridworldsim.training.driven_lines import Lines
from hybridworldsim.training.run.folder import MODEL, Run, read_run
from hybridworldsim.training.run.parameters import read_parameters, set_parameters
from hybridworldsim.training.run.previews import pixels
from hybridworldsim.training.trainable_method import Rendering, TrainableMethod
from hybridworldsim.training.viewpoint import Source, viewpoint_of
from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.views.view import View


class Renderer(Protocol):
    """Renders views of a trained model."""

    def __call__(self, view: View) -> UInt8:
        """(H, W, 3) of a view."""
        ...

    def drawn(self, view: View) -> Rendering:
        """A view with its depth."""
        ...


@dataclass(frozen=True, eq=False)
class OpenBlock:
    """A block and what renders it."""

    run: Run
    learner: TrainableMethod


def open_block(folder: Path, make: Callable[[Initial, Any], TrainableMethod], settings: type) -> OpenBlock:
    """Read a trained block.

    Args:
        folder: of its run.
        make: of the method.
        settings: class of its settings.

    Raises:
        DatasetError: the model is missing or another method's.
    """
    run = read_run(folder)
    learner = make(_placeholder(run), TypeAdapter(settings).validate_python(run.settings))
    set_parameters(learner.model, read_parameters(folder / MODEL))
    return OpenBlock(run, learner)


class Opened:
    """Renders views by the block that the camera is nearest to.

    Args:
        blocks: at least one.
        looking: how pictures look that were not trained on. Methods without latents know the looks that were trained
            on and nothing between them.

    Raises:
        UsageError: the policy needs latents.
    """

    def __init__(self, blocks: Sequence[OpenBlock], looking: AppearancePolicy) -> None:
        if looking.policy in (FITTED, MEAN) or looking.policy.startswith(SWEEP):
            raise UsageError(
                f"{looking.policy!r}, but {blocks[0].run.method} has no latents to fit or to mix",
                place="--appearance", expected="nearest, or one that is given",
            )  # fmt: skip
        self._blocks = list(blocks)
        lines = Lines([source for one in blocks for source in one.run.sources], looking.views)
        self._looks = [
            AppearanceSelector(one.run.sources, looking.policy, looking.views, looking.everywhere, lines)
            for one in blocks
        ]
        self._centres = np.array([one.run.origin_m[:2] for one in blocks])

    def __call__(self, view: View) -> UInt8:
        """(H, W, 3) of a view."""
        return pixels(self.drawn(view).rgb)

    def drawn(self, view: View) -> Rendering:
        """A view with its depth."""
        here = view.pose.translation[0, :2]
        place = int(np.abs(self._centres - here).max(axis=1).argmin())
        block = self._blocks[place]
        look = self._looks[place].of(view)
        ((source, _),) = look.colours
        viewpoint = viewpoint_of(view, np.array(block.run.origin_m)).seen_by(source)
        return block.learner.render(viewpoint)


def _placeholder(run: Run) -> Initial:
    """Something of the right kinds to make a model of: all its rows are replaced."""
    flat: Float64 = np.zeros((1, 3))

    def ground(places: Float64) -> tuple[Float64, Float64]:
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    sources = [Source(one.traversal_id, one.camera) for one in run.sources]
    return Initial(flat, np.empty((0, 3)), flat, ground, run.radius_m, sources, np.zeros((1, 3), np.uint8))
