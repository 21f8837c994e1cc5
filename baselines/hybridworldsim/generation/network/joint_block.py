"""The joint block of Stable Diffusion 3: the tokens of one image and of its text attend to each other.

P. Esser et al., Scaling Rectified Flow Transformers (2024). Names of parameters are those of the released state dicts.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm, scaled_dot_product_attention, silu

EPSILON = 1e-6


class FeedForward(nn.Module):
    """Two linear layers with GELU (tanh approximation), or with a gated GELU between them.

    Args:
        width: channels.
        gated: whether the first layer has a gate for each of its channels.
    """

    def __init__(self, width: int, *, gated: bool = False) -> None:
        super().__init__()
        self.net = nn.ModuleList(
            [_Projection(width, 4 * width, gated=gated), nn.Identity(), nn.Linear(4 * width, width)]
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (..., width) to (..., width)."""
        return self.net[2](self.net[0](x))


class _Projection(nn.Module):
    def __init__(self, width: int, out: int, *, gated: bool) -> None:
        super().__init__()
        self.gated = gated
        self.proj = nn.Linear(width, 2 * out if gated else out)

    def forward(self, x: Tensor) -> Tensor:
        if not self.gated:
            return nn.functional.gelu(self.proj(x), approximate="tanh")
        values, gate = self.proj(x).chunk(2, dim=-1)
        return values * nn.functional.gelu(gate)


class HeadNorm(nn.Module):
    """Root-mean-square normalisation of each head's queries or keys.

    Args:
        channels: channels of a head.
        epsilon: added to the mean square.
    """

    def __init__(self, channels: int, epsilon: float) -> None:
        super().__init__()
        self.epsilon = epsilon
        self.weight = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Map (..., channels) to (..., channels)."""
        return nn.functional.rms_norm(x, self.weight.shape, self.weight.to(x.dtype), self.epsilon)


def split_heads(x: Tensor, heads: int) -> Tensor:
    """Map (N, L, heads * channels) to (N, heads, L, channels)."""
    return x.unflatten(-1, (heads, -1)).transpose(1, 2)


def merge_heads(x: Tensor) -> Tensor:
    """Map (N, heads, L, channels) to (N, L, heads * channels)."""
    return x.transpose(1, 2).flatten(2)


class JointAttention(nn.Module):
    """Attention among image tokens, and text tokens where ``text`` is set.

    Args:
        width: channels of a token.
        heads: number of heads.
        norm: whether queries and keys are normalised.
        text: whether text tokens take part.
        text_out: whether text tokens are changed.
    """

    def __init__(self, width: int, heads: int, *, norm: bool, text: bool = True, text_out: bool = True) -> None:
        super().__init__()
        self.heads = heads
        head = width // heads
        self.norm_q, self.norm_k = (HeadNorm(head, EPSILON) if norm else nn.Identity() for _ in range(2))
        self.to_q, self.to_k, self.to_v = (nn.Linear(width, width) for _ in range(3))
        if text:
            self.add_k_proj, self.add_v_proj, self.add_q_proj = (nn.Linear(width, width) for _ in range(3))
            self.norm_added_q, self.norm_added_k = (HeadNorm(head, EPSILON) if norm else nn.Identity() for _ in "qk")
        self.to_out = nn.ModuleList([nn.Linear(width, width)])
        if text and text_out:
            self.to_add_out = nn.Linear(width, width)

    def forward(self, image: Tensor, text: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """Map image tokens (N, L, width) and text tokens (N, M, width) to tokens of the same shapes."""
        query = self.norm_q(split_heads(self.to_q(image), self.heads))
        key = self.norm_k(split_heads(self.to_k(image), self.heads))
        value = split_heads(self.to_v(image), self.heads)
        if text is not None:
            query = torch.cat([query, self.norm_added_q(split_heads(self.add_q_proj(text), self.heads))], dim=2)
            key = torch.cat([key, self.norm_added_k(split_heads(self.add_k_proj(text), self.heads))], dim=2)
            value = torch.cat([value, split_heads(self.add_v_proj(text), self.heads)], dim=2)
        mixed = merge_heads(scaled_dot_product_attention(query, key, value))
        length = image.shape[1]
        out = self.to_out[0](mixed[:, :length])
        if text is None or not hasattr(self, "to_add_out"):
            return out, None
        return out, self.to_add_out(mixed[:, length:])


class Modulation(nn.Module):
    """Shifts, scales and gates from the time step and the text.

    Args:
        width: channels of a token.
        parts: number of vectors.
    """

    def __init__(self, width: int, parts: int) -> None:
        super().__init__()
        self.parts = parts
        self.linear = nn.Linear(width, parts * width)

    def forward(self, condition: Tensor) -> tuple[Tensor, ...]:
        """Map (N, width) to ``parts`` tensors (N, 1, width)."""
        return self.linear(silu(condition))[:, None].chunk(self.parts, dim=-1)


def normalise(x: Tensor) -> Tensor:
    """Normalise the last axis (layer normalisation without parameters)."""
    return layer_norm(x, x.shape[-1:], eps=EPSILON)


class JointBlock(nn.Module):
    """One block of joint attention between image and text tokens.

    Args:
        width: channels of a token.
        heads: number of heads.
        norm: whether queries and keys are normalised.
        dual: whether a second attention runs among the image tokens only.
        last: whether text tokens are not changed, because no block follows.
    """

    def __init__(self, width: int, heads: int, *, norm: bool, dual: bool, last: bool) -> None:
        super().__init__()
        self.last = last
        self.norm1 = Modulation(width, 9 if dual else 6)
        self.norm1_context = Modulation(width, 2 if last else 6)
        self.attn = JointAttention(width, heads, norm=norm, text_out=not last)
        self.attn2 = JointAttention(width, heads, norm=norm, text=False) if dual else None
        self.ff = FeedForward(width)
        self.ff_context = None if last else FeedForward(width)

    def forward(self, image: Tensor, text: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Map image tokens (N, L, width) and text tokens (N, M, width), modulated by (N, width), to the same shapes.

        Without text (M = 0) the text's half of the block is not computed: it has no effect on the image.
        """
        shift, scale, gate, shift_ff, scale_ff, gate_ff, *dual = self.norm1(condition)
        plain = normalise(image)
        entered: Tensor | None = None
        text_gates: list[Tensor] = []
        if text.shape[1] and self.last:
            # Stable Diffusion 3 has the scale first here.
            text_scale, text_shift = self.norm1_context(condition)
            entered = normalise(text) * (1 + text_scale) + text_shift
        elif text.shape[1]:
            text_shift, text_scale, *text_gates = self.norm1_context(condition)
            entered = normalise(text) * (1 + text_scale) + text_shift
        mixed, text_mixed = self.attn(plain * (1 + scale) + shift, entered)
        image = image + gate * mixed
        if self.attn2 is not None:
            shift_2, scale_2, gate_2 = dual
            image = image + gate_2 * self.attn2(plain * (1 + scale_2) + shift_2)[0]
        image = image + gate_ff * self.ff(normalise(image) * (1 + scale_ff) + shift_ff)
        if not text_gates or text_mixed is None or self.ff_context is None:
            return image, text
        text_gate, text_shift_ff, text_scale_ff, text_gate_ff = text_gates
        text = text + text_gate * text_mixed
        text = text + text_gate_ff * self.ff_context(normalise(text) * (1 + text_scale_ff) + text_shift_ff)
        return image, text
