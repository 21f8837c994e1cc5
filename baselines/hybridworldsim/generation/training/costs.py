"""The memory and the time of training a generator, which are printed before it starts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from hybridworldsim.generation.devices import computing_in
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, predict_velocity
from mirror.devices import CPU

_PER_PARAMETER: Final = 4 * 5
"""Bytes: the parameter, its gradient, two moments and the average."""
_SIDE: Final = 512
_TIMED_S: Final = 0.2
_WITH_GRADIENTS: Final = 3.0
"""A product of matrices has two more for its gradients."""
_LIBRARIES: Final = 500 << 20


@dataclass(frozen=True)
class TrainingCosts:
    """The costs of a training step, counted with tensors that have shapes and no numbers.

    Attributes:
        parameters: number of parameters.
        memory_bytes: of parameters, gradients, moments, averages and the activations that gradients need.
        operations: floating-point operations of a step.
    """

    parameters: int
    memory_bytes: int
    operations: float

    def describe(self, steps: int, device: str, speed: float) -> str:
        """Return the costs of a training in words.

        Args:
            steps: number of steps.
            device: where it trains.
            speed: operations a second that the device reaches in a large matrix product, see `measure_speed`.
        """
        hours, of_cores = steps * self.operations / speed / 3600.0, "core-" if device == CPU else ""
        time_left = f"{hours:.1f} {of_cores}hours" if hours >= 1.0 else f"{60.0 * hours:.1f} {of_cores}minutes"
        return (
            f"generator of {self.parameters / 1e6:.1f} million parameters: about {self.memory_bytes / 1e9:.1f} GB of "
            f"memory; at least {time_left} for {steps} steps, at the speed of a large matrix product"
        )


@lru_cache(maxsize=16)
def count_costs(settings: GeneratorSettings, size_px: tuple[int, int], views: int, processes: int = 1) -> TrainingCosts:
    """Count the costs of a step of a training, of the same settings once in a process.

    Args:
        settings: the settings of the training.
        size_px: height and width of the clips' images.
        views: number of cameras.
        processes: number of processes, which share a batch.
    """
    config, batch = settings.network, settings.batch // (processes * settings.accumulate)
    # On the meta device attention would keep all its weights, which no device does.
    with FakeTensorMode():
        network = Transformer(config)
        network.recompute = settings.recompute
        conditions = empty_conditions(config, size_px, views, CPU, batch=batch, frames=_frames(settings))
        grid = [side // config.latent_stride for side in size_px]
        references, noisy = (
            torch.zeros(batch, frames, views, config.latent_channels, *grid) for frames in (settings.references, 1)
        )
        level, reference_level = (torch.zeros(batch, frames, views) for frames in (1, settings.references))
        own, kept = {one.untyped_storage()._cdata for one in network.parameters()}, {}

        def keep(tensor: Tensor) -> Tensor:
            # Views share the memory of their tensor; parameters are counted apart.
            storage = tensor.untyped_storage()
            if storage._cdata not in own:
                kept[storage._cdata] = storage.nbytes()
            return tensor

        with (
            FlopCounterMode(display=False) as counter,
            torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor),
        ):
            with computing_in(settings.precision, CPU):
                predict_velocity(network, noisy, references, conditions, level, reference_level)
            activations = sum(kept.values())
    parameters = sum(one.numel() for one in network.parameters())
    memory = _PER_PARAMETER * parameters + activations + _LIBRARIES
    operations = _WITH_GRADIENTS * float(counter.get_total_flops()) * settings.accumulate
    return TrainingCosts(parameters, memory, operations)


def empty_conditions(
    config: TransformerConfig, size_px: tuple[int, int], views: int, device: str, *, batch: int = 1, frames: int = 1
) -> Conditions:
    """Return conditions of zeros, without text, to count or to time what a network computes.

    Args:
        config: the network.
        size_px: height and width of the images.
        views: number of views.
        device: where they are.
        batch: number of sequences.
        frames: number of frames.
    """
    shape = (batch, frames, views)

    def images(channels: int | None) -> Tensor | None:
        return None if channels is None else torch.zeros(*shape, channels, *size_px, device=device)

    return Conditions(
        size_px,
        torch.eye(3, device=device).expand(*shape, 3, 3).contiguous(),
        torch.eye(4, device=device).expand(*shape, 4, 4).contiguous(),
        torch.eye(4, device=device).expand(batch, frames, 4, 4).contiguous(),
        torch.full((batch,), 5.0, device=device),
        torch.zeros(*shape, 0, config.text_channels, device=device),
        torch.zeros(*shape, config.pooled_channels, device=device),
        images(None if config.layout is None else config.layout.channels),
        images(None if config.background is None else 3),
    )


@lru_cache(maxsize=16)
def measure_speed(device: str, precision: str = "float32") -> float:
    """Return the operations of a product of large matrices a second of a GPU, or a second of a processor's core.

    They are measured once in a process.
    """
    dtype = torch.bfloat16 if precision == "bf16" else torch.float32
    one, other = (torch.ones(_SIDE, _SIDE, dtype=dtype, device=device) for _ in range(2))
    # Other work on a processor's cores makes a product take longer, not more of their time.
    clock = time.process_time if device == CPU else time.perf_counter
    seconds: list[float] = []
    while len(seconds) < 4 or sum(seconds) < _TIMED_S:
        begin = clock()
        # Reading a number back waits for the device.
        float((one @ other)[0, 0])
        seconds.append(clock() - begin)
    return 2.0 * _SIDE**3 / min(seconds)


def _frames(settings: GeneratorSettings) -> int:
    return 1 if settings.network.reference_channels else 1 + settings.references
