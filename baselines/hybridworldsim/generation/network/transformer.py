"""CTSD, the cross-view temporal diffusion transformer of OpenDWM, with a background adapter.

Tokens of each image attend to each other and to the image's text (joint blocks); after some of these blocks tokens
attend to other frames (temporal blocks) or to other views (cross-view blocks). Paper: Dynamic Scene Generation.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import cast

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from hybridworldsim.generation.network.adapter import ImageAdapter, add_features
from hybridworldsim.generation.network.conditions import Conditions, PreparedConditions, ReferenceCache
from hybridworldsim.generation.network.configuration import CAMERA_NUMBERS, TransformerConfig
from hybridworldsim.generation.network.embeddings import (
    NumberEmbedding,
    PatchEmbedding,
    RayEncoder,
    StepTextEmbedding,
    camera_numbers,
    encode_number,
    token_rays,
)
from hybridworldsim.generation.network.joint_block import JointBlock, Modulation, normalise
from hybridworldsim.generation.network.masks import cross_view_mask, temporal_mask
from hybridworldsim.generation.network.mixing_block import KeysValues, Mixer, MixingBlock
from mirror.errors import UsageError

_NUMBER_CHANNELS = 256


class Transformer(nn.Module):
    """The transformer. Submodules have the names of OpenDWM's state dicts.

    Args:
        config: its configuration.

    Attributes:
        config: its configuration.
        recompute: whether training computes layers twice instead of keeping their activations.
    """

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.config, self.recompute = config, False
        width, heads = config.width, config.heads
        channels = config.latent_channels + config.reference_channels
        self.pos_embed = PatchEmbedding(channels, width, config.patch, config.grid, config.grid_base)
        self.time_text_embed = StepTextEmbedding(width, config.pooled_channels)
        self.context_embedder = nn.Linear(config.text_channels, width)
        self.transformer_blocks = nn.ModuleList(
            JointBlock(
                width, heads, norm=config.joint_norm, dual=layer in config.dual_layers, last=layer == config.layers - 1
            )
            for layer in range(config.layers)
        )
        self.norm_out = Modulation(width, 2)
        self.proj_out = nn.Linear(width, config.patch**2 * config.latent_channels)
        if config.reference_channels:
            self.reference_embedder = NumberEmbedding(_NUMBER_CHANNELS, width, width)
            nn.init.zeros_(self.reference_embedder.linear_2.weight)
            nn.init.zeros_(self.reference_embedder.linear_2.bias)
        if config.camera == "implicit":
            self.view_embedding = NumberEmbedding(CAMERA_NUMBERS * _NUMBER_CHANNELS, width, width)
        elif config.camera == "explicit":
            self.rayencoder = RayEncoder(width, config.origin_octaves, config.direction_octaves)
        self.temporal_transformer_blocks, self.crossview_transformer_blocks = (
            nn.ModuleList(MixingBlock(width, heads, norm=config.mixing_norm) for _ in layers)
            for layers in (config.temporal_layers, config.cross_view_layers)
        )
        self.time_pos_embeds, self.view_pos_embeds = (
            nn.ModuleList(NumberEmbedding(width, 4 * width, width) for _ in layers)
            for layers in (config.temporal_layers, config.cross_view_layers)
        )
        self.time_mixers, self.view_mixers = (
            nn.ModuleList(Mixer() for _ in layers) for layers in (config.temporal_layers, config.cross_view_layers)
        )
        if config.layout is not None:
            self.condition_image_adapter = ImageAdapter(config.layout, config.token_px, width)
        if config.background is not None:
            self.background_adapter = ImageAdapter(config.background, config.token_px, width)

    def encode_images(self, conditions: Conditions) -> list[Tensor]:
        """Return the adapters' features; the features of a frame do not depend on the other frames.

        Returns:
            A feature (B * T * V, rows * columns, width) for each of the first layers.

        Raises:
            UsageError: an image has other channels, or no whole number of tokens, or the network has no such adapter.
        """
        return add_features(self.encode_layout(conditions), self.encode_background(conditions))

    def encode_layout(self, conditions: Conditions) -> list[Tensor]:
        """Return the features of the layout alone, as in `encode_images`; empty if there is no layout."""
        return self._adapt("condition_image_adapter", conditions.layout)

    def encode_background(self, conditions: Conditions) -> list[Tensor]:
        """Return the features of the background alone, as in `encode_images`; empty if there is no background."""
        return self._adapt("background_adapter", conditions.background)

    def _adapt(self, name: str, images: Tensor | None) -> list[Tensor]:
        if images is None:
            return []
        adapter: ImageAdapter | None = getattr(self, name, None)
        if adapter is None:
            raise UsageError(f"images for {name}, which this network does not have")
        self._require_tokens(images, adapter.config.channels, self.config.token_px)
        return adapter(images.flatten(0, 2))

    def prepare(self, conditions: Conditions, features: list[Tensor] | None = None) -> PreparedConditions:
        """Compute what the network derives from a frame independently of the sampling step.

        Args:
            conditions: of B sequences of T frames of V views.
            features: result of `encode_images` for them; None: it is computed.

        Raises:
            UsageError: as `encode_images`.
        """
        text = self.context_embedder(conditions.text.flatten(0, 2))
        index, present = conditions.view_index, conditions.present
        if present is not None and bool(present.all()):
            # Attention without a mask is faster.
            present = None
        return PreparedConditions(
            conditions.shape,
            text,
            conditions.pooled.flatten(0, 2),
            self._embed_cameras(conditions),
            self.encode_images(conditions) if features is None else features,
            present,
            conditions.adjacent,
            torch.arange(conditions.shape[2], device=text.device) if index is None else index,
        )

    def forward(
        self,
        latents: Tensor,
        timestep: Tensor,
        prepared: PreparedConditions,
        cache: ReferenceCache | None = None,
        *,
        reference_timestep: Tensor | None = None,
    ) -> Tensor:
        """Return the velocity, noise minus clean latents, of each frame.

        Args:
            latents: (B, T, V, latent_channels + reference_channels, H, W).
            timestep: (B, T, V) noise level of each frame, from 0 (clean) to 1000 (noise only).
            prepared: the conditions of these frames.
            cache: reference frames before these ones, for a causal network.
            reference_timestep: (B, T, V) noise level of the references in further channels; None: they are clean.

        Returns:
            (B, T, V, latent_channels, H, W).

        Raises:
            UsageError: shapes do not fit, or a cache is given to a network that is not causal.
        """
        tokens, condition = self._run(latents, timestep, prepared, cache, None, reference_timestep)
        config, (rows, columns) = self.config, self._grid(latents)
        scale, shift = self.norm_out(condition)
        patches = self.proj_out(normalise(tokens) * (1 + scale) + shift)
        patches = patches.view(-1, rows, columns, config.patch, config.patch, config.latent_channels)
        images = patches.permute(0, 5, 1, 3, 2, 4).reshape(-1, config.latent_channels, *latents.shape[-2:])
        return images.unflatten(0, prepared.shape)

    def encode_references(
        self, latents: Tensor, timestep: Tensor, prepared: PreparedConditions, earlier: ReferenceCache | None = None
    ) -> ReferenceCache:
        """Run the network once over reference frames, and keep the keys and values for later frames.

        Arguments are those of `forward`, `earlier` its cache; what follows the last temporal block's keys and values is
        not computed. The result is of these frames only.

        Raises:
            UsageError: shapes do not fit, or the network is not causal.
        """
        collected: list[KeysValues] = []
        if not self.config.causal:
            raise UsageError(
                "references of a network that is not causal change with every step",
                expected="a causal network", remedy="pass references as frames of the sequence",
            )  # fmt: skip
        if self.config.temporal_layers:
            self._run(latents, timestep, prepared, earlier, collected)
        first = 0 if earlier is None else earlier.first + earlier.frames
        return ReferenceCache(prepared.shape[1], tuple(collected), prepared.present, first)

    def _run(
        self,
        latents: Tensor,
        timestep: Tensor,
        prepared: PreparedConditions,
        cache: ReferenceCache | None,
        collected: list[KeysValues] | None,
        reference_timestep: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Tokens (B * T * V, L, width) behind the last block, and the modulation (B * T * V, width)."""
        config = self.config
        self._require_tokens(latents, config.latent_channels + config.reference_channels, config.patch)
        if tuple(latents.shape[:3]) != prepared.shape or timestep.shape != latents.shape[:3]:
            raise UsageError(
                f"latents of {tuple(latents.shape[:3])} and time steps of {tuple(timestep.shape)} frames",
                expected=f"{prepared.shape}, as the conditions: sequences, frames, views",
            )
        if cache is not None and not config.causal:
            raise UsageError("cached references for a network that is not causal", expected="a causal network")
        grid = self._grid(latents)
        image = self.pos_embed(latents.flatten(0, 2))
        text, condition = prepared.text, self.time_text_embed(timestep.flatten(), prepared.pooled)
        if config.reference_channels and reference_timestep is not None:
            encoded = encode_number(reference_timestep.flatten(), _NUMBER_CHANNELS)
            condition = condition + self.reference_embedder(encoded.to(condition.dtype))
        for layer, block in enumerate(self.transformer_blocks):
            if layer < len(prepared.features):
                image = image + prepared.features[layer]
            if self.recompute and torch.is_grad_enabled():
                image, text = checkpoint(block, image, text, condition, use_reentrant=False)
            else:
                image, text = block(image, text, condition)
            if layer in config.temporal_layers:
                place = config.temporal_layers.index(layer)
                last = collected is not None and place == len(config.temporal_layers) - 1
                if last:
                    image = self._mix_frames(place, image, prepared, cache, collected, keys_only=True)
                    break
                image = self._mix_frames(place, image, prepared, cache, collected)
            if layer in config.cross_view_layers:
                image = self._mix_views(config.cross_view_layers.index(layer), image, prepared, grid)
        return image, condition

    def _mix_frames(
        self,
        place: int,
        image: Tensor,
        prepared: PreparedConditions,
        cache: ReferenceCache | None,
        collected: list[KeysValues] | None,
        *,
        keys_only: bool = False,
    ) -> Tensor:
        batch, frames, views = prepared.shape
        earlier, length = 0 if cache is None else cache.frames, image.shape[1]
        first = 0 if cache is None else cache.first + earlier
        block, full = (
            cast(MixingBlock, self.temporal_transformer_blocks[place]),
            self.config.temporal_attention == "full",
        )
        # bfloat16 has no odd numbers above 256.
        counted = torch.promote_types(image.dtype, torch.float32)
        index = torch.arange(first, first + frames, device=image.device, dtype=counted)
        embedding = self.time_pos_embeds[place](encode_number(index, self.config.width).to(image.dtype))
        embedding = embedding[None, :, None].expand(batch, frames, views, -1).reshape(-1, 1, self.config.width)
        tokens = image + (embedding if prepared.camera is None else embedding + prepared.camera)
        # Axes: sequence, frame, view, token. Attention runs over the last axis but one of what is made of them.
        tokens = tokens.unflatten(0, prepared.shape)
        if full:
            tokens = tokens.transpose(1, 2).reshape(batch * views, frames * length, -1)
        else:
            tokens = tokens.permute(0, 2, 3, 1, 4).reshape(batch * views * length, frames, -1)
        entered, normalised, own = block.enter(tokens)
        if collected is not None:
            collected.append(own)
        if keys_only:
            return image
        keys_values = own
        if cache is not None:
            keys_values = KeysValues(*(torch.cat(pair, dim=2) for pair in zip(cache.layers[place], own)))
        mask = temporal_mask(
            prepared.present,
            None if cache is None else cache.present,
            shape=prepared.shape,
            earlier=earlier,
            causal=self.config.causal,
            tokens=length,
            pointwise=not full,
            device=image.device,
        )
        mixed = block.leave(entered, normalised, keys_values, mask)
        if full:
            mixed = mixed.view(batch, views, frames, length, -1).transpose(1, 2)
        else:
            mixed = mixed.view(batch, views, length, frames, -1).permute(0, 3, 1, 2, 4)
        return self.time_mixers[place](image, mixed.reshape(image.shape))

    def _mix_views(self, place: int, image: Tensor, prepared: PreparedConditions, grid: tuple[int, int]) -> Tensor:
        batch, frames, views = prepared.shape
        rows, columns = grid
        block = cast(MixingBlock, self.crossview_transformer_blocks[place])
        embedding = self.view_pos_embeds[place](
            encode_number(prepared.view_index.to(image.dtype), self.config.width).to(image.dtype)
        )
        embedding = embedding.expand(batch * frames, views, -1).reshape(-1, 1, self.config.width)
        tokens = image + (embedding if prepared.camera is None else embedding + prepared.camera)
        tokens = tokens.view(batch * frames, views, rows, columns, -1).transpose(1, 2)
        tokens = tokens.reshape(batch * frames * rows, views * columns, -1)
        entered, normalised, keys_values = block.enter(tokens)
        mask = cross_view_mask(prepared.present, prepared.adjacent, shape=prepared.shape, rows=rows, columns=columns)
        mixed = block.leave(entered, normalised, keys_values, mask)
        mixed = mixed.view(batch * frames, rows, views, columns, -1).transpose(1, 2)
        return self.view_mixers[place](image, mixed.reshape(image.shape))

    def _embed_cameras(self, conditions: Conditions) -> Tensor | None:
        config = self.config
        batch, frames, views = conditions.shape
        intrinsics, camera_to_ego = conditions.intrinsics.flatten(0, 2), conditions.camera_to_ego.flatten(0, 2)
        rows, columns = (side // config.token_px for side in conditions.size_px)
        if config.camera == "implicit":
            rate = conditions.rate_hz[:, None].expand(batch, frames * views).flatten()
            numbers = camera_numbers(rate, intrinsics, camera_to_ego, columns / rows)
            encoded = encode_number(numbers.flatten(), _NUMBER_CHANNELS).view(len(numbers), -1)
            return self.view_embedding(encoded.to(conditions.pooled.dtype))[:, None]
        if config.camera == "explicit":
            to_first = conditions.ego_to_first[:, :, None].expand(-1, -1, views, -1, -1).flatten(0, 2)
            kind = to_first.device.type
            # Metres need more than the eight bits of bfloat16.
            with torch.autocast(kind, enabled=False) if torch.amp.is_autocast_available(kind) else nullcontext():
                origins, directions = token_rays(intrinsics, to_first @ camera_to_ego, rows, columns)
            return self.rayencoder(origins, directions)
        return None

    def _grid(self, latents: Tensor) -> tuple[int, int]:
        height, width = latents.shape[-2:]
        return height // self.config.patch, width // self.config.patch

    def _require_tokens(self, images: Tensor, channels: int, cell: int) -> None:
        *_, found, height, width = images.shape
        if images.dim() != 6 or found != channels:
            raise UsageError(
                f"an input of shape {tuple(images.shape)}", expected=f"(B, T, V, {channels}, height, width)"
            )
        if height % cell or width % cell or max(height, width) > self.config.grid * cell:
            raise UsageError(
                f"an input of {width} x {height}",
                expected=f"sides that are multiples of {cell}, at most {self.config.grid * cell}",
            )
