"""Temporal and cross-view blocks: tokens of several frames or views attend to each other, mixed with the input."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from hybridworldsim.generation.network.joint_block import FeedForward, HeadNorm, merge_heads, split_heads

_EPSILON = 1e-5
_MIX = 2.0


class KeysValues(NamedTuple):
    """Keys and values of earlier frames in one temporal block.

    Attributes:
        keys: (N, heads, L, channels).
        values: (N, heads, L, channels).
    """

    keys: Tensor
    values: Tensor


class MixingAttention(nn.Module):
    """Self-attention with optional earlier keys and values.

    Args:
        width: channels of a token.
        heads: number of heads.
        norm: whether queries and keys are normalised.
    """

    def __init__(self, width: int, heads: int, *, norm: bool) -> None:
        super().__init__()
        self.heads = heads
        self.norm_q, self.norm_k = (HeadNorm(width // heads, _EPSILON) if norm else nn.Identity() for _ in "qk")
        self.to_q, self.to_k, self.to_v = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.to_out = nn.ModuleList([nn.Linear(width, width)])

    def project(self, tokens: Tensor) -> KeysValues:
        """Return the keys and values of tokens (N, L, width)."""
        keys = self.norm_k(split_heads(self.to_k(tokens), self.heads))
        return KeysValues(keys, split_heads(self.to_v(tokens), self.heads))

    def forward(self, tokens: Tensor, keys_values: KeysValues, mask: Tensor | None) -> Tensor:
        """Let tokens (N, L, width) attend to keys.

        ``mask`` is True where they may: it broadcasts to (N, heads, L, K).
        """
        query = self.norm_q(split_heads(self.to_q(tokens), self.heads))
        mixed = scaled_dot_product_attention(query, keys_values.keys, keys_values.values, attn_mask=mask)
        return self.to_out[0](merge_heads(mixed))


class MixingBlock(nn.Module):
    """Feed-forward, attention, feed-forward, each with a residual.

    Args:
        width: channels of a token.
        heads: number of heads.
        norm: whether queries and keys are normalised.
    """

    def __init__(self, width: int, heads: int, *, norm: bool) -> None:
        super().__init__()
        self.norm_in, self.norm1, self.norm3 = (nn.LayerNorm(width) for _ in range(3))
        self.ff_in, self.ff = (FeedForward(width, gated=True) for _ in range(2))
        self.attn1 = MixingAttention(width, heads, norm=norm)

    def enter(self, tokens: Tensor) -> tuple[Tensor, Tensor, KeysValues]:
        """Compute the layers before the attention.

        Args:
            tokens: (N, L, width).

        Returns:
            The residual (N, L, width), the attention's input (N, L, width), its keys and values.
        """
        tokens = tokens + self.ff_in(self.norm_in(tokens))
        normalised = self.norm1(tokens)
        return tokens, normalised, self.attn1.project(normalised)

    def leave(self, tokens: Tensor, normalised: Tensor, keys_values: KeysValues, mask: Tensor | None) -> Tensor:
        """Compute the attention and the layers after it, from the result of `enter`."""
        tokens = tokens + self.attn1(normalised, keys_values, mask)
        return tokens + self.ff(self.norm3(tokens))


class Mixer(nn.Module):
    """A learned mean of a block's input and output; initially it takes 88 % of the input."""

    def __init__(self) -> None:
        super().__init__()
        self.mix_factor = nn.Parameter(torch.tensor([_MIX]))

    def forward(self, before: Tensor, after: Tensor) -> Tensor:
        """Return ``sigmoid(mix_factor) * before + (1 - sigmoid(mix_factor)) * after``."""
        share = torch.sigmoid(self.mix_factor)
        return share * before + (1.0 - share) * after
