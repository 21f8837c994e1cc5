"""The method of the paper: streets of anchors and Code-Gaussians, several blocks drawn as one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from hybridworldsim.methods.appearance_fitting import fit_appearances
from hybridworldsim.methods.static import StaticMethod, block_folders
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.ply_export import export_gaussians, psnr_to_model_db, write_ply
from hybridworldsim.model.settings import Settings
from hybridworldsim.model.storage import load_block, save_block
from hybridworldsim.model.street import Street
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.training.appearance import FITTED, AppearanceSelector, Blend
from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.run.folder import MODEL, Run, read_run
from hybridworldsim.training.run.previews import pixels
from hybridworldsim.training.trainable_method import Rendering, TrainableMethod
from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.ply_export import PlyExport, PlyExportOptions
from mirror.protocols.views.view import RenderView

NAME: Final = "hybridworldsim"
STRUCTURE_WEIGHT: Final = 0.1


class StreetMethod(StaticMethod):
    """`StaticMethod` whose blocks are composed, and whose looks are latents that can be mixed and fitted."""

    def open(self, model: Path, appearance: AppearancePolicy = AppearancePolicy()) -> StreetRenderer:  # noqa: B008 - immutable
        """See `StaticMethod.open`."""
        return StreetRenderer([_open(folder) for folder in block_folders(model)], appearance)

    def export_ply(
        self,
        model: Path,
        views: Sequence[RenderView],
        out: Path,
        options: PlyExportOptions,
        appearance: AppearancePolicy = AppearancePolicy(),  # noqa: B008
    ) -> PlyExport:
        """See `mirror.methods.ply_export.PlyExporter`."""
        street = StreetRenderer([_open(folder) for folder in block_folders(model)], appearance)
        looks = street.latents(views[0])
        baked = export_gaussians(
            street.blocks, views, looks, degree=options.degree, sky=options.sky, reach_m=options.reach_m
        )
        size = write_ply(out, baked)
        x, y, z = baked.origin_m.tolist()
        return PlyExport(len(baked), size, psnr_to_model_db(baked, street.blocks, views, looks), (x, y, z))

    def write(self, path: Path, block: Block, trainer: TrainableMethod, run: Run, *, half: bool) -> int:
        """See `StaticMethod.write`."""
        if not isinstance(trainer, StreetTrainer):
            raise UsageError(f"a {type(trainer).__name__}", expected="a learner of a street")
        trainer.catch_up()
        return save_block(path, block, trainer.street, half=half, about={"settings_hash": run.settings_hash})


@dataclass(frozen=True, eq=False)
class OpenBlock:
    """A trained block."""

    run: Run
    block: Block
    street: Street


class StreetRenderer:
    """Renders views by all blocks that they see.

    Args:
        blocks: at least one.
        appearance: how images look that were not trained on.

    Raises:
        UsageError: nothing that was trained on matches the policy of the looks, or there is nothing to fit, or to fit
            to.
    """

    def __init__(self, blocks: Sequence[OpenBlock], appearance: AppearancePolicy) -> None:
        seen = [one.run.sources for one in blocks]
        if appearance.policy == FITTED:
            seen = [fit_appearances(one.street, one.block, one.run, appearance) for one in blocks]
            if all(len(own) == len(one.run.sources) for own, one in zip(seen, blocks)):
                raise UsageError(
                    "all looks that are asked for were trained on: nothing to fit", place="--appearance",
                    expected="a split or protocol with traversals that were not", remedy="--appearance nearest",
                )  # fmt: skip
        lines = DrivenLines([source for own in seen for source in own], appearance.views)
        # Whatever is drawn of a block shares its latents.
        self._looks = {
            id(one.street.appearance): AppearanceSelector(
                own, appearance.policy, appearance.views, appearance.everywhere, lines
            )
            for one, own in zip(blocks, seen)
        }
        self.blocks = [(one.block, one.street) for one in blocks]
        self._composition = Composition(self.blocks)

    def __call__(self, view: RenderView) -> UInt8:
        """(H, W, 3) of a view."""
        return pixels(self.render(view).rgb)

    def render(self, view: RenderView) -> Rendering:
        """A view with its depth."""
        output, counts = self._composition.render(view, self.latents(view))
        return Rendering(output.rgb, output.alpha, output.depth_m, counts)

    def latents(self, view: RenderView) -> Callable[[AppearanceLatents], tuple[Tensor, Tensor]]:
        """Of a block's appearance, what a view's colours and content are drawn with."""

        def of(appearance: AppearanceLatents) -> tuple[Tensor, Tensor]:
            look = self._looks[id(appearance)].select(view)
            return blend_latents(appearance, look.colours), appearance(look.content)

        return of


def blend_latents(appearance: AppearanceLatents, blend: Blend) -> Tensor:
    """The latent of a mixture of looks."""
    return torch.stack([weight * appearance(source) for source, weight in blend]).sum(0)


def make(initial: InitialGeometry, settings: Any) -> StreetTrainer:
    """A street that has seen no image yet."""
    return StreetTrainer(initial_street(initial, settings), settings)


def _open(folder: Path) -> OpenBlock:
    block, street, _ = load_block(folder / MODEL)
    return OpenBlock(read_run(folder), block, street)


METHOD: Final = StreetMethod(NAME, make, lambda seed: Settings(seed=seed))
"""With the paper's three losses, depth's error as a share of the depth, and no others."""

STRUCTURE: Final = StreetMethod(
    f"{NAME}_structure", make, lambda seed: Settings(structure_weight=STRUCTURE_WEIGHT, seed=seed)
)
"""With a loss of structure beside them."""


def open_model(folder: Path, appearance: AppearancePolicy = AppearancePolicy()) -> StreetRenderer:  # noqa: B008 - immutable
    """Open a trained model for rendering.

    Args:
        folder: the folder that ``mirror reconstruct`` wrote.
        appearance: how images of traversals and cameras look that were not trained on.

    Returns:
        A renderer: called with a view it returns the pixels (H, W, 3), uint8; its `render` also returns the depth.

    Raises:
        UsageError: no trained traversal matches the appearance policy.
        DatasetError: the folder holds no complete model of this method.
    """
    return METHOD.open(folder, appearance)
