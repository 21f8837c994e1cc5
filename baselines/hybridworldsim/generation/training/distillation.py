"""Distillation to few steps: consistency within segments of the noise levels.

The levels from noise to clean are cut into as many segments as the student may take steps. Within a segment, the
student learns to jump from any level to the segment's end, as the frozen teacher does in many small steps (Y. Song et
al., "Consistency Models", 2023; J. Heek et al., "Multistep Consistency Models", 2024). The result is sampled as the
teacher is, with one step for each segment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call

from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.flow import add_noise
from hybridworldsim.generation.training.generator_trainer import (
    GeneratorSettings,
    GeneratorTrainer,
    mean_of_views,
    mean_over_present,
    predict_velocity,
)
from hybridworldsim.generation.training.windows import ClipWindows, WindowBatch
from mirror.errors import UsageError


@dataclass(frozen=True)
class DistillationSettings:
    """Settings of a distillation.

    Attributes:
        segments: steps of the student.
        teacher_steps: small steps of the teacher from noise to clean; a multiple of `segments`.
    """

    segments: int = 4
    teacher_steps: int = 32

    def __post_init__(self) -> None:
        if self.segments < 1 or self.teacher_steps % self.segments or self.teacher_steps < self.segments:
            raise UsageError(
                f"{self.teacher_steps} steps of the teacher in {self.segments} segments",
                expected="as many steps in each segment, at least one",
            )

    @property
    def document(self) -> dict[str, Any]:
        """All settings as JSON values."""
        return asdict(self)


def segment_end(level: Tensor, segments: int) -> Tensor:
    """Return the lower end of the segment that contains each level; a segment includes its upper end."""
    return (torch.ceil(level * segments - 1e-6) - 1.0) / segments


class ConsistencyLoss(nn.Module):
    """The squared error between the student's jump and its averaged copy's jump from one small teacher's step later.

    Args:
        student: the network in training.
        teacher: frozen.
        averaged: gives the averaged parameters of the student.
        settings: see `DistillationSettings`.
    """

    def __init__(
        self,
        student: Transformer,
        teacher: Transformer,
        averaged: Callable[[], Mapping[str, Tensor]],
        settings: DistillationSettings,
    ) -> None:
        super().__init__()
        self.network = student
        # In a tuple, so that the teacher's parameters are not parameters of this module.
        self._teacher = (teacher,)
        self._averaged, self._settings = averaged, settings

    def forward(self, batch: WindowBatch, level: Tensor, reference_level: Tensor, noise: Tensor) -> Tensor:
        """Compute the mean error over the views that exist.

        The error is that of the velocity which leads to the segment's end.
        """
        count = batch.references.shape[1]
        noisy = add_noise(batch.target, noise[:, count:], level)
        references = add_noise(batch.references, noise[:, :count], reference_level)
        given = batch.conditions
        with torch.no_grad():
            end = segment_end(level, self._settings.segments)
            lower = (level - 1.0 / self._settings.teacher_steps).clamp(min=0.0)
            (teacher,) = self._teacher
            velocity = predict_velocity(teacher, noisy, references, given, level, reference_level).float()
            stepped = noisy + _wide(lower - level) * velocity
            state = dict(self.network.named_buffers()) | dict(self._averaged())
            later = functional_call(
                _Velocity(self.network), _prefixed(state), (stepped, references, given, lower, reference_level)
            ).float()
            # At the segment's end nothing is left to jump over.
            reached = stepped + _wide(end - lower) * later
            wanted = (reached - noisy) / _wide(end - level)
        own = predict_velocity(self.network, noisy, references, given, level, reference_level).float()
        return mean_over_present(mean_of_views((own - wanted).square(), batch.weight), batch.present)


class _Velocity(nn.Module):
    """`predict_velocity` as a module, so that it can be called with other parameters."""

    def __init__(self, network: Transformer) -> None:
        super().__init__()
        self.network = network

    def forward(self, *arguments: Any) -> Tensor:
        return predict_velocity(self.network, *arguments)


def _prefixed(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"network.{name}": tensor for name, tensor in state.items()}


def _wide(level: Tensor) -> Tensor:
    return level[..., None, None, None]


class DistillationTrainer(GeneratorTrainer):
    """A trainer of a student, which starts as a copy of its teacher.

    Args:
        settings: how steps are made; the weighting is not used.
        distillation: segments and steps of the teacher.
        teacher: the trained network.
        windows: what it is trained on.
        steps: number of steps of the whole training.
        seed: seed of the order of windows and of all noise.
        device: where the networks are.
        rank: number of this process.
        processes: number of processes, which share each batch.
    """

    def __init__(
        self,
        settings: GeneratorSettings,
        distillation: DistillationSettings,
        teacher: Transformer,
        windows: ClipWindows,
        steps: int,
        *,
        seed: int = 0,
        device: str = "cpu",
        rank: int = 0,
        processes: int = 1,
    ) -> None:
        self._distillation = distillation
        self._teacher = deepcopy(teacher).eval().requires_grad_(False).to(device)
        student = deepcopy(teacher).train().requires_grad_(True)
        super().__init__(
            settings, windows, steps, seed=seed, network=student, device=device, rank=rank, processes=processes
        )

    def _make_loss(self) -> nn.Module:
        return ConsistencyLoss(self.network, self._teacher, lambda: self._averaged, self._distillation)

    def _draw_levels(self, count: int, generator: torch.Generator) -> Tensor:
        """Levels at which the teacher makes a step, each equally often."""
        steps = self._distillation.teacher_steps
        return torch.randint(1, steps + 1, (count,), generator=generator) / steps
