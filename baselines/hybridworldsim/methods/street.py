"""The method of the paper: streets of anchors and Code-Gaussians; several blocks are rendered as one street."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from hybridworldsim.methods.appearance_fitting import fit_appearances
from hybridworldsim.methods.estimates import TableSizes
from hybridworldsim.methods.gpu_settings import scale_street
from hybridworldsim.methods.interactive import InteractiveStreet
from hybridworldsim.methods.static import StaticMethod, block_folders
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition, LampSelector
from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.lamps import Lamps
from hybridworldsim.model.ply_export import export_gaussians, psnr_to_model_db, write_ply
from hybridworldsim.model.settings import LightSettings, Settings
from hybridworldsim.model.storage import load_block, save_block
from hybridworldsim.model.street import StreetModel, StreetOutput
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.rasterizer.covers import covered_before
from hybridworldsim.trainable.method import Rendering, TrainableMethod
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from hybridworldsim.training.appearance import FITTED, AppearanceSelector, Blend
from hybridworldsim.training.documents import Run, read_run
from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.previews import pixels
from hybridworldsim.training.run.folder import MODEL
from mirror.arrays import Float32, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities
from mirror.methods.ply_export import PlyExport, PlyExportOptions
from mirror.protocols.views.view import RenderView

NAME: Final = "hybridworldsim"
STRUCTURE_WEIGHT: Final = 0.1
ALL: Final = Capabilities(
    renders_depth=True,
    renders_covers=True,
    opens_interactively=True,
    exports_ply=True,
    takes_device=True,
    rasterizes=True,
    distributes_blocks=True,
)


@dataclass(frozen=True)
class StreetMethod(StaticMethod):
    """A `StaticMethod` with composed blocks and with appearances that can be mixed and fitted."""

    capabilities: Capabilities | None = ALL

    def open(
        self,
        model: Path,
        appearance: AppearancePolicy = AppearancePolicy(),  # noqa: B008 - immutable
        *,
        device: str = CPU,
    ) -> StreetRenderer:
        """See `StaticMethod.open` and `mirror.methods.method_devices.DeviceMethod`."""
        return StreetRenderer([_open(folder) for folder in block_folders(model)], appearance, device)

    def open_interactive(self, model: Path, *, device: str = CPU) -> InteractiveStreet:
        """See `mirror.methods.interactive.InteractiveDeviceMethod`."""
        opened = [_open(folder) for folder in block_folders(model)]
        return InteractiveStreet([(block.block, block.street, block.run.sources) for block in opened], device)

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
        select_latents = street.latents(views[0])
        exported = export_gaussians(
            street.blocks, views, select_latents, degree=options.degree, sky=options.sky, reach_m=options.reach_m
        )
        size = write_ply(out, exported)
        x, y, z = exported.origin_m.tolist()
        return PlyExport(
            len(exported), size, psnr_to_model_db(exported, street.blocks, views, select_latents), (x, y, z)
        )

    def write(self, path: Path, block: Block, trainer: TrainableMethod, run: Run, *, half: bool) -> int:
        """See `StaticMethod.write`."""
        if not isinstance(trainer, StreetTrainer):
            raise UsageError(f"a {type(trainer).__name__}", expected="a StreetTrainer")
        trainer.finish()
        return save_block(path, block, trainer.street, half=half, about={"settings_hash": run.settings_hash})


@dataclass(frozen=True, eq=False)
class OpenStreetBlock:
    """A trained block."""

    run: Run
    block: Block
    street: StreetModel


class StreetRenderer:
    """A renderer of each view by all blocks that it sees.

    Args:
        blocks: at least one block.
        appearance: policy for untrained traversals and cameras.
        device: where views are rendered; appearances are fitted on the CPU.

    Raises:
        UsageError: no trained appearance matches the policy, or there is nothing to fit or no truth to fit to.
    """

    def __init__(self, blocks: Sequence[OpenStreetBlock], appearance: AppearancePolicy, device: str = CPU) -> None:
        trained = [block.run.sources for block in blocks]
        if appearance.policy == FITTED:
            trained = [fit_appearances(block.street, block.block, block.run, appearance) for block in blocks]
            if all(len(cameras) == len(block.run.sources) for cameras, block in zip(trained, blocks)):
                raise UsageError(
                    "nothing to fit: the model was trained on all requested traversals", place="--appearance",
                    expected="a split or protocol with other traversals", remedy="--appearance nearest",
                )  # fmt: skip
        lines = DrivenLines([source for cameras in trained for source in cameras], appearance.views)
        # All rendered copies of a block share its latents.
        self._selectors = {
            id(block.street.appearance): AppearanceSelector(
                cameras, appearance.policy, appearance.views, appearance.everywhere, lines
            )
            for block, cameras in zip(blocks, trained)
        }
        self._headlights = appearance.headlights
        self.blocks = [(block.block, block.street) for block in blocks]
        self._composition = Composition(self.blocks, device)

    def __call__(self, view: RenderView) -> UInt8:
        """Render the pixels (H, W, 3) of a view."""
        return pixels(self.render(view).rgb)

    def render(self, view: RenderView) -> Rendering:
        """Render a view with its depth."""
        rendering, _ = self._draw(view)
        return replace(rendering, rgb=self.expose(view, rendering.rgb))

    def render_covers(self, view: RenderView, limit_m: Float32) -> tuple[Rendering, Tensor]:
        """Render a view, and return the share (H, W) of each pixel that the street nearer than a depth covers.

        Args:
            view: the view.
            limit_m: (H, W) depth (camera z) of each pixel; 0 or less: nothing is before it.
        """
        rendering, output = self._draw(view)
        return replace(rendering, rgb=self.expose(view, rendering.rgb)), _covers(output, limit_m)

    def render_unexposed(self, view: RenderView, limit_m: Float32 | None) -> tuple[Rendering, Tensor | None]:
        """Render a view at the mean exposure of its appearance.

        See `mirror.methods.depth_renderers.ExposingRenderer`.
        """
        rendering, output = self._draw(view)
        return rendering, None if limit_m is None else _covers(output, limit_m)

    def expose(self, view: RenderView, colours: Tensor, noise_seed: int | None = None) -> Tensor:
        """Return the image (H, W, 3) that a view's camera takes of unexposed colours; see `ExposingRenderer`."""
        street = self.blocks[self._composition.home(view)][1]
        if street.light is None:
            return colours
        source = self._source(street, view)
        image = street.light.respond(colours, source)
        noise = None if noise_seed is None else street.light.noise_at(source, view.width_px)
        if noise is None or noise_seed is None:
            return image
        noisy = noise.add(image.cpu().numpy(), noise_seed)
        return torch.from_numpy(noisy).to(image.device, torch.float32) / 255.0

    def chosen_exposure(self, view: RenderView) -> tuple[Tensor, float, Callable[[Tensor, float], Tensor]] | None:
        """Return the exposure that the camera of a view chooses; None where the model does not know it.

        Args:
            view: the view.

        Returns:
            The unexposed colours (H, W, 3); the logarithm of the gain; and a function of such colours and of the
            logarithm of a gain that returns the camera's image.
        """
        street = self.blocks[self._composition.home(view)][1]
        if street.light is None:
            return None
        light, source = street.light, self._source(street, view)
        colours = self._draw(view)[0].rgb
        return colours, light.log_gain(colours, source), lambda image, gain: light.response(image, source.camera, gain)

    def _draw(self, view: RenderView) -> tuple[Rendering, StreetOutput]:
        output, counts = self._composition.render(view, self.latents(view), self._lamps(view))
        return Rendering(output.rgb, output.alpha, output.depth_m, counts), output

    def latents(self, view: RenderView) -> Callable[[AppearanceLatents], tuple[Tensor, Tensor]]:
        """Return a function that selects the latents of a view's colours and content from a block's appearance."""

        def select(appearance: AppearanceLatents) -> tuple[Tensor, Tensor]:
            choice = self._selectors[id(appearance)].select(view)
            return blend_latents(appearance, choice.colours), appearance(choice.content)

        return select

    def _source(self, street: StreetModel, view: RenderView) -> Source:
        """The trained source whose light a view has."""
        choice = self._selectors[id(street.appearance)].select(view)
        return max(choice.colours, key=lambda pair: pair[1])[0]

    def _lamps(self, view: RenderView) -> LampSelector:
        """A function that selects the headlights of a block: as strong as the share of appearances that have some."""

        def select(street: StreetModel, viewpoint: Viewpoint) -> Lamps | None:
            if street.light is None or not self._headlights:
                return None
            colours = self._selectors[id(street.appearance)].select(view).colours
            lamps = [(street.lamps(viewpoint, source), weight) for source, weight in colours]
            lit = [(one, weight) for one, weight in lamps if one is not None]
            return replace(lit[0][0], share=sum(weight for _, weight in lit)) if lit else None

        return select


def _covers(output: StreetOutput, limit_m: Float32) -> Tensor:
    """The share (H, W) of each pixel that is covered before a depth; a view that sees no node has no Gaussians."""
    return covered_before(output.meta, limit_m) if output.parts else torch.zeros_like(output.alpha)


def blend_latents(appearance: AppearanceLatents, blend: Blend) -> Tensor:
    """Return the weighted mean of latents."""
    return torch.stack([weight * appearance(source) for source, weight in blend]).sum(0)


def make(initial: InitialGeometry, settings: Any) -> StreetTrainer:
    """Make an untrained street."""
    return StreetTrainer(initial_street(initial, settings), settings)


def _open(folder: Path) -> OpenStreetBlock:
    block, street, _ = load_block(folder / MODEL)
    return OpenStreetBlock(read_run(folder), block, street)


def table_sizes(settings: Settings) -> TableSizes:
    """Return the largest sizes of a street's tables."""
    refinement, k = settings.refinement, settings.offsets
    plain = refinement.most_ground + refinement.most_sky
    return TableSizes(
        refinement.max_anchors * (9 + 3 * k + settings.code) + plain * (11 + settings.plain_code),
        refinement.max_anchors * k + plain,
    )


def seeded(seed: int) -> Settings:
    """Return the settings of the paper's method."""
    return Settings(seed=seed)


def seeded_structure(seed: int) -> Settings:
    """Return the settings with a structure loss."""
    return Settings(structure_weight=STRUCTURE_WEIGHT, seed=seed)


METHOD: Final = StreetMethod(NAME, make, seeded, sizes=table_sizes, scale=scale_street)
"""The paper's three losses only; the depth error is a share of the depth."""

STRUCTURE: Final = StreetMethod(
    f"{NAME}_structure",
    make,
    seeded_structure,
    sizes=table_sizes,
    scale=scale_street,
)
"""The paper's losses and a structure loss."""


LIGHT: Final = StreetMethod(
    f"{NAME}_light",
    make,
    lambda seed: LightSettings(seed=seed),
    capabilities=replace(ALL, separates_exposure=True, has_headlights=True),
    sizes=table_sizes,
    scale=scale_street,
    reads_light=True,
)
"""The paper's losses, with the exposure of each image, the cameras' response, and the vehicle's headlights."""


def open_model(folder: Path, appearance: AppearancePolicy = AppearancePolicy()) -> StreetRenderer:  # noqa: B008 - immutable
    """Open a trained model for rendering.

    Args:
        folder: the folder that ``mirror reconstruct`` wrote.
        appearance: policy for untrained traversals and cameras.

    Returns:
        A renderer. Called with a view, it returns the pixels (H, W, 3), uint8; its `render` also returns the depth.

    Raises:
        UsageError: no trained traversal matches the appearance policy.
        DatasetError: the folder holds no complete model of this method.
    """
    return METHOD.open(folder, appearance)
