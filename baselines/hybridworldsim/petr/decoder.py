"""The transformer decoder: queries attend to each other and to all image positions of all cameras."""

from __future__ import annotations

from torch import Tensor, nn


class Attention(nn.Module):
    """Multi-head attention with a shortcut; positions are added to queries and keys, not to values."""

    def __init__(self, dim: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(dim, heads, dropout, batch_first=True)

    def forward(self, x: Tensor, position: Tensor, keys: Tensor, key_position: Tensor) -> Tensor:
        """Let queries (B, Q, C) attend to keys (B, K, C); returns (B, Q, C)."""
        attended: Tensor = self.attn(x + position, keys + key_position, keys, need_weights=False)[0]
        return x + attended


class PetrFeedForward(nn.Module):
    """Two linear layers with a shortcut, named as in the published checkpoints."""

    def __init__(self, dim: int, hidden: int, dropout: float) -> None:
        super().__init__()
        first = nn.Sequential(nn.Linear(dim, hidden), nn.ReLU(inplace=True), nn.Dropout(dropout))
        self.layers = nn.Sequential(first, nn.Linear(hidden, dim), nn.Dropout(dropout))

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, Q, C) to the same shape."""
        return x + self.layers(x)


class DecoderLayer(nn.Module):
    """Attention among queries, attention to the images, feed-forward; a normalisation after each."""

    def __init__(self, dim: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([Attention(dim, heads, dropout), Attention(dim, heads, dropout)])
        self.ffns = nn.ModuleList([PetrFeedForward(dim, hidden, dropout)])
        self.norms = nn.ModuleList([nn.LayerNorm(dim) for _ in range(3)])

    def forward(self, x: Tensor, position: Tensor, memory: Tensor, memory_position: Tensor) -> Tensor:
        """Map (B, Q, C) to the same shape."""
        x = self.norms[0](self.attentions[0](x, position, x, position))
        x = self.norms[1](self.attentions[1](x, position, memory, memory_position))
        out: Tensor = self.norms[2](self.ffns[0](x))
        return out


class Decoder(nn.Module):
    """All layers, whose outputs share one normalisation."""

    def __init__(self, layers: int, dim: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.layers = nn.ModuleList(DecoderLayer(dim, heads, hidden, dropout) for _ in range(layers))
        self.post_norm = nn.LayerNorm(dim)

    def forward(self, x: Tensor, position: Tensor, memory: Tensor, memory_position: Tensor) -> list[Tensor]:
        """Return the output (B, Q, C) of each layer."""
        outputs = []
        for layer in self.layers:
            x = layer(x, position, memory, memory_position)
            outputs.append(self.post_norm(x))
        return outputs


class PetrTransformer(nn.Module):
    """A holder of the decoder under the published name, as the checkpoint's keys need it."""

    def __init__(self, layers: int, dim: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.decoder = Decoder(layers, dim, heads, hidden, dropout)
