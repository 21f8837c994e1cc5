"""Trains explicit Gaussians on images; a `hybridworldsim.training.trainable_method.TrainableMethod`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.optim import SGD, Optimizer

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.covers import covered_before
from hybridworldsim.training.run.state import dump, load
from hybridworldsim.training.trainable_method import Rendering, StepReport
from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import Viewpoint
from mirror.arrays import Float32
from mirror_baselines.splatting.appearance import FinishedImage
from mirror_baselines.splatting.density import DensityControl
from mirror_baselines.splatting.losses import image_losses, surface_losses
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.row_adam import RowAdam
from mirror_baselines.splatting.settings import Splatting


@dataclass(frozen=True, eq=False)
class RenderOutput:
    """A rendered image, with what the optimiser reads.

    Attributes:
        finished: colours.
        alpha: (H, W).
        depth_m: (H, W) expected depth.
        rows: (M,) int64 rows of the tables that may be visible.
        geometry: copies of these rows of each table of geometry, leaves that may require gradients.
        spherical_harmonics: (M, K, 3) coefficients of these rows, likewise.
        meta: results of the rasterizer; ``gaussian_ids`` are rows of the tables.
    """

    finished: FinishedImage
    alpha: Tensor
    depth_m: Tensor
    rows: Tensor
    geometry: dict[str, Tensor]
    spherical_harmonics: Tensor
    meta: dict[str, Any]


class SplattingTrainer:
    """Gaussians with their optimisers and their densification.

    Args:
        model: the model, changed in place.
        settings: its settings.
    """

    def __init__(self, model: Gaussians, settings: Splatting) -> None:
        self.model, self.settings = model, settings
        self._adams = {name: RowAdam(table) for name, table in model.tables.items()}
        self.density = DensityControl(settings.densification, settings.seed, len(model))
        self._steps = 0

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Train on one image; see `TrainableMethod`."""
        settings, appearance = self.settings, self.model.look
        self.model.sh_degree.fill_(min(int(progress / settings.sh_step), settings.sh_degree))
        for name, adam in self._adams.items():
            adam.param_groups[0]["lr"] = getattr(settings.rates, name.split("_")[0]).at(progress)
        appearance.prepare(image.viewpoint, progress)
        output = self._render(image.viewpoint, learning=True)
        weights = settings.weights
        losses = {
            **image_losses(output.finished, image, weights),
            **surface_losses(
                output.depth_m, output.alpha, image, weights, normals=self._steps % weights.normal_every == 0
            ),
            **appearance.losses(output.alpha, image),
        }
        total = torch.stack([weight * loss for weight, loss in losses.values() if weight]).sum()
        self.density.before_backward(output.meta)
        total.backward()
        self._update(output, image)
        self.density.after_backward(self.model.tables, self._adams, output.meta, progress)
        self._steps += 1
        return StepReport({name: float(loss.detach()) for name, (_, loss) in losses.items()}, len(self.model))

    def _update(self, output: RenderOutput, image: TrainingImage) -> None:
        for name, leaf in output.geometry.items():
            if leaf.grad is not None:
                self._adams[name].update(output.rows, leaf.grad)
        if output.spherical_harmonics.grad is not None:
            for name, first, past in self.model.look.bands(image.viewpoint.source, int(self.model.sh_degree)):
                self._adams[name].update(output.rows, output.spherical_harmonics.grad, 3 * first, 3 * (past - first))
        self.model.look.update(image.viewpoint)

    @property
    def reads_depth(self) -> bool:
        """See `TrainableMethod`."""
        return bool(self.settings.weights.depth or self.settings.weights.normal)

    @torch.no_grad()
    def render(self, viewpoint: Viewpoint) -> Rendering:
        """See `TrainableMethod`."""
        return self._to_rendering(self._render(viewpoint, learning=False))

    @torch.no_grad()
    def render_covers(self, viewpoint: Viewpoint, limit_m: Float32) -> tuple[Rendering, Tensor]:
        """See `CoverTrainableMethod`."""
        output = self._render(viewpoint, learning=False)
        return self._to_rendering(output), covered_before(output.meta, limit_m)

    def _to_rendering(self, output: RenderOutput) -> Rendering:
        counts = {"held": len(self.model), "decoded": len(output.rows), "drawn": len(output.meta["gaussian_ids"])}
        return Rendering(output.finished.rgb, output.alpha, output.depth_m, counts)

    def _render(self, viewpoint: Viewpoint, *, learning: bool) -> RenderOutput:
        model = self.model
        rows = model.visible_ids(viewpoint)
        geometry, spherical_harmonics = model.geometry(rows), model.spherical_harmonics(rows, viewpoint.source)
        for leaf in (*geometry.values(), spherical_harmonics):
            leaf.requires_grad_(learning)
        images, alphas, meta = rasterization(
            geometry["means"],
            geometry["quats"],
            geometry["scales"].exp(),
            geometry["opacities"].sigmoid(),
            spherical_harmonics,
            viewpoint.viewmat[None],
            viewpoint.K[None],
            viewpoint.width_px,
            viewpoint.height_px,
            near_plane=self.settings.near_m,
            sh_degree=int(model.sh_degree),
            render_mode="RGB+ED",
            rasterize_mode="antialiased" if self.settings.antialiased else "classic",
            absgrad=self.settings.densification.absolute,
            nonfinite="cull",
        )
        meta["gaussian_ids"] = rows[meta["gaussian_ids"]]
        alpha = alphas[0, ..., 0]
        finished = model.look.finish(images[0, ..., :3], alpha, viewpoint)
        return RenderOutput(finished, alpha, images[0, ..., 3], rows, geometry, spherical_harmonics, meta)

    def state(self) -> dict[str, Tensor]:
        """See `TrainableMethod`."""
        moments = self._moments()
        for optimizer in self._optimizers():
            moments.state.update(optimizer.state)
        return {"counters": torch.tensor([self._steps]), **self.density.state(), **dump(self.model, moments)}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """See `TrainableMethod`."""
        moments = self._moments()
        load(self.model, state, moments)
        for optimizer in self._optimizers():
            for group in optimizer.param_groups:
                optimizer.state.update(
                    {table: moments.state[table] for table in group["params"] if table in moments.state}
                )
        self.density.restore(state)
        (self._steps,) = state["counters"].tolist()

    def _optimizers(self) -> list[Optimizer]:
        return [*self._adams.values(), *self.model.look.optimizers()]

    def _moments(self) -> Optimizer:
        """An optimiser that only stores moments: gsplat needs one for each table, checkpoints need one in all."""
        return SGD(self.model.parameters(), lr=0.0)
