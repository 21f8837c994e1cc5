"""Rollouts: each frame is generated from the T frames before it, which are seeds at first and then its own output."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hybridworldsim.generation.devices import computing_in
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.inference.sliding_cache import SlidingCache
from hybridworldsim.generation.inference.windows import join_conditions, join_features, without_layout
from hybridworldsim.generation.network.adapter import add_features
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.sampler import draw_noise
from mirror.errors import DatasetError, UsageError

_CONTEXT = 1


@dataclass(eq=False)
class _Frame:
    """Conditions of one frame, and the adapters' features once a window has needed them."""

    conditions: Conditions
    features: list[list[Tensor]] | None = None


class SequenceRollout:
    """One rollout of B sequences. Seeds are not output.

    Args:
        network: the network.
        seeds: (B, T, V, C, H, W) latents of the seeds.
        seed_conditions: conditions of each seed, one frame each; `ego_to_first` is in a frame that all frames share.
        settings: how a frame is sampled.
        seed: seed of the noise; the noise of a frame depends on it and on the number of the frame only.
        first: number of the first generated frame.
        dropped_layout: value of layout images that guidance leaves out; see `without_layout`.

    Attributes:
        frame: number of the next frame.
        generated_views: number of views generated so far.
        kept_views: number of views that were given instead.
        sliding: the keys and values that are kept from frame to frame, if the settings ask for it.

    Raises:
        UsageError: seeds and conditions do not fit each other or are not finite, or keys and values are to be kept of a
            network that is not causal or has its references as channels.
    """

    def __init__(
        self,
        network: Transformer,
        seeds: Tensor,
        seed_conditions: Sequence[Conditions],
        settings: SamplerSettings,
        *,
        seed: int = 0,
        first: int = 0,
        dropped_layout: float = 0.0,
    ) -> None:
        if seeds.shape[1] != len(seed_conditions) or not seed_conditions:
            raise UsageError(
                f"{seeds.shape[1]} seeds with conditions of {len(seed_conditions)} frames",
                expected="as many, at least one",
            )
        for conditions in seed_conditions:
            conditions.require_finite()
        if settings.refresh_every > 1 and (not network.config.causal or network.config.reference_channels):
            raise UsageError(
                f"refresh_every {settings.refresh_every} for this network",
                expected="a causal network with references as frames", remedy="leave it at 1",
            )  # fmt: skip
        self._network, self._settings, self._seed = network, settings, seed
        self._dropped_layout = dropped_layout
        self.sliding = SlidingCache(settings.refresh_every) if settings.refresh_every > 1 else None
        self.frame = first
        self.generated_views = self.kept_views = 0
        count = len(seed_conditions)
        self._latents: deque[Tensor] = deque(seeds.split(1, dim=1), maxlen=count)
        self._frames: deque[_Frame] = deque(map(_Frame, seed_conditions), maxlen=count)
        # Features of a frame do not depend on its place in the window; as channels, they belong to the whole window.
        self._keeps_features = not network.config.reference_channels
        self._empty_layout: list[Tensor] = []

    @torch.no_grad()
    def step(
        self,
        conditions: Conditions,
        *,
        active: Sequence[int] | None = None,
        kept: Tensor | None = None,
    ) -> Tensor:
        """Generate the next frame.

        Args:
            conditions: of the frame, as those of the seeds.
            active: views that are generated; None: all. The others cost nothing.
            kept: (B, 1, V, C, H, W) latents of the other views, such as those of the empty street.

        Returns:
            (B, 1, V, C, H, W) latents.

        Raises:
            UsageError: conditions are not finite or do not fit the seeds, or latents of other views are missing.
            DatasetError: the network gives latents that are not finite.
        """
        conditions.require_finite()
        references = torch.cat(list(self._latents), dim=1)
        batch, views = references.shape[0], references.shape[2]
        shape = (batch, 1, *references.shape[2:])
        if conditions.shape != (batch, 1, views):
            raise UsageError(f"conditions of {conditions.shape}", expected=f"{(batch, 1, views)}, as the seeds")
        chosen = list(range(views)) if active is None else list(active)
        if len(chosen) < views and (kept is None or kept.shape != shape):
            raise UsageError("no latents of the views that are not generated", expected=f"latents of shape {shape}")
        frame = _Frame(conditions)
        if chosen:
            noise = draw_noise(shape, (self._seed, self.frame), device=references.device).to(references.dtype)
            latents = self._sample(references, [*self._frames, frame], noise, chosen)
            if not bool(latents.isfinite().all()):
                raise DatasetError(
                    "the network gives numbers that are not finite", place=f"frame {self.frame}",
                    expected="finite latents", remedy="use --precision float32, or train with a lower learning rate",
                )  # fmt: skip
        if kept is not None and len(chosen) < views:
            whole = kept.clone()
            if chosen:
                whole[:, :, chosen] = latents
            latents = whole
        self._latents.append(latents)
        self._frames.append(frame)
        self.frame += 1
        self.generated_views += batch * len(chosen)
        self.kept_views += batch * (views - len(chosen))
        return latents

    def _features_of(self, frame: _Frame) -> list[list[Tensor]]:
        """The adapters' features of one frame, and with guidance those without layout behind them.

        They are computed when a window first needs them: frames between which nothing is generated cost nothing.
        """
        if frame.features is None:
            frame.features = self._encode_images(frame.conditions)
        return frame.features

    def _encode_images(self, conditions: Conditions) -> list[list[Tensor]]:
        network = self._network
        with computing_in(self._settings.precision, conditions.pooled.device):
            layout, background = network.encode_layout(conditions), network.encode_background(conditions)
            if self._settings.guidance == 1.0:
                return [add_features(layout, background)]
            # An empty layout is the same in every frame.
            self._empty_layout = self._empty_layout or network.encode_layout(
                without_layout(conditions, self._dropped_layout)
            )
            return [add_features(one, background) for one in (layout, self._empty_layout)]

    def _sample(
        self,
        references: Tensor,
        frames: Sequence[_Frame],
        noise: Tensor,
        chosen: list[int],
    ) -> Tensor:
        """The latents of the chosen views of the last of T + 1 frames."""
        config, views = self._network.config, references.shape[2]
        origin = None
        if self.sliding is not None:
            origin = self.sliding.begin(self.frame, chosen, frames[0].conditions.ego_to_first)
        window = join_conditions(config, [one.conditions for one in frames], origin).views(chosen)
        features: list[list[Tensor]] = []
        if self._keeps_features:
            shape = (len(references), references.shape[1] + 1, views)
            for parts in zip(*map(self._features_of, frames)):
                joined = join_features(parts, (shape[0], views))
                features.append([one.unflatten(0, shape)[:, :, chosen].flatten(0, 2) for one in joined])
        context_noise = None
        if self._settings.context_noise > 0.0:
            seeds = self._seed, self.frame, _CONTEXT
            context_noise = draw_noise(references.shape, seeds, device=references.device)[:, :, chosen]
        without = None if self._settings.guidance == 1.0 else without_layout(window, self._dropped_layout)
        return sample_frame(
            self._network, references[:, :, chosen], window, noise[:, :, chosen], self._settings,
            features=features[0] if features else None, context_noise=context_noise, unconditional=without,
            unconditional_features=features[1] if features[1:] else None, sliding=self.sliding,
        )  # fmt: skip
