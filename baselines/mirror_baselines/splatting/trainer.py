"""Trains explicit Gaussians on images; a `hybridworldsim.trainable.method.TrainableMethod`."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.optim import SGD, Optimizer

from hybridworldsim.trainable.method import StepReport
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.training.run.state import dump, load
from mirror.devices import CPU
from mirror_baselines.splatting.density import DensityControl
from mirror_baselines.splatting.losses import image_losses, surface_losses
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.renderer import RenderOutput, SplattingRenderer
from mirror_baselines.splatting.row_adam import RowAdam
from mirror_baselines.splatting.settings import Splatting


class SplattingTrainer(SplattingRenderer):
    """Gaussians with their optimisers and their densification.

    Args:
        model: the model, changed in place.
        settings: its settings.
    """

    def __init__(self, model: Gaussians, settings: Splatting) -> None:
        super().__init__(model, settings)
        self._adams = {name: RowAdam(table) for name, table in model.tables.items()}
        self.density = DensityControl(settings.densification, settings.seed, len(model))
        self._steps = 0

    def to(self, device: str) -> SplattingTrainer:
        """Return a trainer of the same untrained Gaussians on a device."""
        return self if device == CPU else SplattingTrainer(self.model.to(device), self.settings)

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Train on one image; see `TrainableMethod`."""
        image = image.to(self.model.tables["means"].device)
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
        # Read together: each reading waits for the GPU.
        values = torch.stack([loss.detach() for _, loss in losses.values()]).tolist()
        return StepReport(dict(zip(losses, values)), len(self.model))

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
        self.density.to(self.model.tables["means"].device)
        (self._steps,) = state["counters"].tolist()

    def _optimizers(self) -> list[Optimizer]:
        return [*self._adams.values(), *self.model.look.optimizers()]

    def _moments(self) -> Optimizer:
        """An optimiser that only stores moments: gsplat needs one for each table, checkpoints need one in all."""
        return SGD(self.model.parameters(), lr=0.0)
