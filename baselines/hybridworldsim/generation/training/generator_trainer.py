"""Training steps of the generator: the velocity of noisy targets, given their references."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.generation.devices import Precision, computing_in
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TINY, TINY_REFERENCES, TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.flow import (
    TIMESTEPS,
    Weighting,
    add_noise,
    draw_levels,
    loss_weight,
    noise_levels,
)
from hybridworldsim.generation.training.self_rollout import draw_self_rollout, roll_out_references
from hybridworldsim.generation.training.windows import ClipWindows, WindowBatch
from hybridworldsim.training.run.state import dump, load
from mirror.errors import UsageError

_EMA = "ema."
_CLIP = 1.0


@dataclass(frozen=True)
class GeneratorSettings:
    """Settings of a generator's training.

    Attributes:
        network: its configuration.
        references: T, number of reference frames.
        weighting: whose square error the loss is.
        batch: windows of a step, over all processes.
        accumulate: parts of a batch that are computed one after another.
        learning_rate: highest rate; it falls in proportion to the remaining steps.
        warmup: steps in which the rate rises.
        weight_decay: of AdamW.
        context_noise: highest noise level of the references, drawn evenly for each window; the network is given it.
        self_rollout: share of windows whose references are the network's own output where the clip has frames before
            them; see `roll_out_references`. Each of them costs up to ``references * self_rollout_steps`` passes.
        self_rollout_steps: steps of the sampler for such a reference.
        drop_layout: share of windows without layout, for guidance.
        ema: highest decay of the averaged parameters; in step n it is ``min(ema, (1 + n) / (10 + n))``.
        precision: ``bf16``: the network computes in bfloat16, with parameters in float32.
        recompute: whether activations of layers are computed again for the gradient, to save memory.
    """

    network: TransformerConfig = TINY
    references: int = TINY_REFERENCES
    weighting: Weighting = "velocity"
    batch: int = 4
    accumulate: int = 1
    learning_rate: float = 1e-3
    warmup: int = 100
    weight_decay: float = 0.01
    context_noise: float = 0.0
    self_rollout: float = 0.0
    self_rollout_steps: int = 2
    drop_layout: float = 0.0
    ema: float = 0.995
    precision: Precision = "float32"
    recompute: bool = False

    def __post_init__(self) -> None:
        if self.batch < 1 or self.accumulate < 1 or self.batch % self.accumulate:
            raise UsageError(f"a batch of {self.batch} in {self.accumulate} parts", expected="parts of equal size")
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0.0):
            raise UsageError(f"learning_rate {self.learning_rate}", expected="a finite number above 0")
        for name in ("context_noise", "drop_layout", "ema"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise UsageError(f"{name} {getattr(self, name)}", expected="from 0 to below 1")
        if not 0.0 <= self.self_rollout <= 1.0:
            raise UsageError(f"self_rollout {self.self_rollout}", expected="a share from 0 to 1")
        noise_levels(self.self_rollout_steps)

    def require_shares(self, processes: int) -> None:
        """Check that a batch can be divided into equal parts among processes and accumulated steps.

        Raises:
            UsageError: its parts on so many processes would differ in size.
        """
        if self.batch % (processes * self.accumulate):
            raise UsageError(
                f"a batch of {self.batch} on {processes} processes in {self.accumulate} parts",
                place="--batch",
                expected=f"a multiple of {processes * self.accumulate}",
            )

    @property
    def document(self) -> dict[str, Any]:
        """All settings as JSON values; the settings of a self-rollout only if there is one."""
        from dataclasses import asdict

        document = asdict(self)
        if self.self_rollout == 0.0:
            # Without it, runs from before it existed continue.
            del document["self_rollout"], document["self_rollout_steps"]
        return document


class _Loss(nn.Module):
    """The loss of a batch, as a module, so that `DistributedDataParallel` can wrap it."""

    def __init__(self, network: Transformer, weighting: Weighting) -> None:
        super().__init__()
        self.network = network
        self._weighting: Weighting = weighting

    def forward(self, batch: WindowBatch, level: Tensor, reference_level: Tensor, noise: Tensor) -> Tensor:
        """Mean square error of the target, over the views that exist."""
        count = batch.references.shape[1]
        noisy = add_noise(batch.target, noise[:, count:], level)
        references = add_noise(batch.references, noise[:, :count], reference_level)
        velocity = predict_velocity(self.network, noisy, references, batch.conditions, level, reference_level)
        square = (velocity.float() - (noise[:, count:] - batch.target)).square()
        return mean_over_present(
            mean_of_views(square, batch.weight) * loss_weight(level, self._weighting), batch.present
        )


def predict_velocity(
    network: Transformer,
    noisy: Tensor,
    references: Tensor,
    conditions: Conditions,
    level: Tensor,
    reference_level: Tensor,
) -> Tensor:
    """Return the velocity of a noisy target, in training.

    Args:
        network: the network.
        noisy: (B, 1, V, C, H, W) target at its noise level.
        references: (B, T, V, C, H, W) at their noise level.
        conditions: of the window, from `join_conditions`.
        level: (B, 1, V) noise level of the target.
        reference_level: (B, T, V) noise level of the references.

    Returns:
        (B, 1, V, C, H, W).
    """
    count = references.shape[1]
    prepared = network.prepare(conditions)
    steps, reference_steps = TIMESTEPS * level, TIMESTEPS * reference_level
    if network.config.reference_channels:
        stacked = torch.cat([noisy, references.transpose(1, 2).flatten(2, 3)[:, None]], dim=3)
        return network(stacked, steps, prepared, reference_timestep=reference_steps[:, :1])
    window = torch.cat([references, noisy], dim=1)
    return network(window, torch.cat([reference_steps, steps], dim=1), prepared)[:, count:]


def mean_of_views(values: Tensor, weight: Tensor | None) -> Tensor:
    """Return the mean (B, 1, V) of the values (B, 1, V, C, H, W) of each view.

    Args:
        values: values of latents.
        weight: (B, 1, V, H, W) factor of each latent; None: 1.
    """
    if weight is None:
        return values.mean(dim=(3, 4, 5))
    return (values.mean(dim=3) * weight).mean(dim=(3, 4))


def mean_over_present(values: Tensor, present: Tensor) -> Tensor:
    """Return the mean of values (B, 1, V) over the views that exist (B, 1, V)."""
    return (values * present).sum() / present.sum().clamp(min=1)


class GeneratorTrainer:
    """A network in training. A step depends on its number, the seed and the state only.

    Args:
        settings: see `GeneratorSettings`.
        windows: what it is trained on.
        steps: number of steps of the whole training.
        seed: seed of the parameters, of the order of windows and of all noise.
        network: a network to continue with, such as a released one; None: a new one.
        device: where the network is.
        rank: number of this process.
        processes: number of processes, which share each batch.

    Attributes:
        network: the network.
    """

    def __init__(
        self,
        settings: GeneratorSettings,
        windows: ClipWindows,
        steps: int,
        *,
        seed: int = 0,
        network: Transformer | None = None,
        device: str = "cpu",
        rank: int = 0,
        processes: int = 1,
    ) -> None:
        settings.require_shares(processes)
        torch.manual_seed(seed)
        self._settings, self._windows, self._steps, self._seed = settings, windows, steps, seed
        self._device, self._rank, self._processes = device, rank, processes
        self.network = (Transformer(settings.network) if network is None else network).to(device)
        self.network.recompute = settings.recompute
        self._optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=settings.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=settings.weight_decay,
            fused=True,
        )
        self._averaged = {name: one.detach().clone() for name, one in self.network.named_parameters()}
        loss = self._make_loss()
        # Without text the parameters of its tokens have no part in the loss.
        # Buffers are constants, equal in all processes.
        self._loss = (
            nn.parallel.DistributedDataParallel(loss, find_unused_parameters=True, broadcast_buffers=False)
            if processes > 1
            else loss
        )

    def _make_loss(self) -> nn.Module:
        """The loss of a batch, level, reference level and noise, as a module that holds the network."""
        return _Loss(self.network, self._settings.weighting)

    def _draw_levels(self, count: int, generator: torch.Generator) -> Tensor:
        """Noise levels (count,) of the targets of a part."""
        return draw_levels((count,), generator)

    def step(self, number: int) -> dict[str, float]:
        """Do a step; returns the losses by name."""
        settings = self._settings
        for group in self._optimizer.param_groups:
            group["lr"] = settings.learning_rate * _rate(number, settings.warmup, self._steps)
        self._optimizer.zero_grad(set_to_none=True)
        total = 0.0
        for part in range(settings.accumulate):
            last = part == settings.accumulate - 1
            with nullcontext() if last or self._processes == 1 else self._loss.no_sync():  # type: ignore[operator]
                loss = self._part_loss(number, part) / settings.accumulate
                loss.backward()
            total += float(loss.detach())
        nn.utils.clip_grad_norm_(self.network.parameters(), _CLIP)
        self._optimizer.step()
        decay = min(settings.ema, (1.0 + number) / (10.0 + number))
        with torch.no_grad():
            for name, parameter in self.network.named_parameters():
                self._averaged[name].lerp_(parameter, 1.0 - decay)
        return {settings.weighting: total}

    def _part_loss(self, number: int, part: int) -> Tensor:
        settings = self._settings
        size = settings.batch // (self._processes * settings.accumulate)
        # The windows of a step depend on neither the number of processes nor that of parts.
        drawn = np.random.default_rng([self._seed, number]).integers(0, len(self._windows), settings.batch)
        first = (part * self._processes + self._rank) * size
        state = np.random.SeedSequence([self._seed, number, first]).generate_state(1, np.uint64)[0]
        generator = torch.Generator().manual_seed(int(state >> np.uint64(1)))
        chosen = drawn[first : first + size].tolist()
        batch = self._windows.batch(chosen)
        _, views = batch.target.shape[1:3]
        level = self._draw_levels(size, generator)[:, None, None].expand(size, 1, views)
        reference_level = settings.context_noise * torch.rand((size, 1, 1), generator=generator)
        reference_level = reference_level.expand(size, batch.references.shape[1], views)
        noise = torch.randn((size, batch.references.shape[1] + 1, *batch.target.shape[2:]), generator=generator)
        dropped = torch.rand((size, 1, 1, 1, 1, 1), generator=generator) < settings.drop_layout
        conditions = batch.conditions
        if conditions.layout is not None and settings.drop_layout > 0.0:
            conditions = replace(conditions, layout=conditions.layout.masked_fill(dropped, 0.0))
        batch = replace(batch, conditions=conditions).to(self._device)
        if settings.self_rollout > 0.0:
            # Not where the loss is computed: older versions of torch would use weights there that were cast without
            # gradient.
            batch = replace(batch, references=self._own_references(number, first, chosen, batch.references))
        with computing_in(settings.precision, self._device):
            return self._loss(batch, level.to(self._device), reference_level.to(self._device), noise.to(self._device))

    def _own_references(self, number: int, first: int, windows: list[int], recorded: Tensor) -> Tensor:
        """References (B, T, V, C, H, W) of a part: some are recorded, the others the network's own output."""
        settings = self._settings
        sampler = SamplerSettings(settings.self_rollout_steps, precision=settings.precision)
        references = recorded.clone()
        for place, window in enumerate(windows):
            seed = draw_self_rollout(self._seed, number, first + place, settings.self_rollout)
            if seed is not None:
                history = self._windows.history(window).to(self._device)
                references[place] = roll_out_references(self.network, history, settings.references, sampler, seed)[0]
        return references

    def averaged_network(self) -> Transformer:
        """Return a copy of the network with the averaged parameters."""
        with torch.device("meta"):
            network = Transformer(self._settings.network)
        state = {name: tensor.detach().clone() for name, tensor in self.network.state_dict().items()}
        state |= {name: tensor.clone() for name, tensor in self._averaged.items()}
        network.load_state_dict(state, assign=True)
        return network.eval().requires_grad_(False)

    def state(self) -> dict[str, Tensor]:
        """Return everything that a run needs to continue, by name."""
        return dump(self.network, self._optimizer) | {f"{_EMA}{name}": one for name, one in self._averaged.items()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from the result of `state`.

        Raises:
            DatasetError: a parameter is missing.
        """
        with torch.no_grad():
            load(self.network, state, self._optimizer)
            self._averaged = {name: state[f"{_EMA}{name}"].to(self._device).clone() for name in self._averaged}


def _rate(number: int, warmup: int, steps: int) -> float:
    """Share of the highest learning rate in a step: it rises, then falls to 0 behind the last step."""
    return min((number + 1) / max(warmup, 1), 1.0) * (1.0 - number / steps)
