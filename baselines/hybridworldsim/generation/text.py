"""Embedded captions: text enters the network as vectors that were computed elsewhere; an empty text needs none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError


@dataclass(frozen=True, eq=False)
class TextEmbedding:
    """The embedding of one caption.

    Attributes:
        tokens: (M, text_channels); M may be 0.
        pooled: (pooled_channels,).
    """

    tokens: Tensor
    pooled: Tensor

    @classmethod
    def empty(cls, config: TransformerConfig) -> TextEmbedding:
        """No text: no tokens, and zeros for the pooled vector."""
        return cls(torch.zeros(0, config.text_channels), torch.zeros(config.pooled_channels))


class Captioner(Protocol):
    """Describes the references of a frame: a vision-language model, a table, or always the same words."""

    def __call__(self, traversal_id: str, frame: int, view: str) -> str:
        """The caption of a view's reference frames."""
        ...


class CachedEmbeddings:
    """Embeddings of captions in a safetensors file: ``<caption>/tokens`` and ``<caption>/pooled``.

    Args:
        path: the file.
        config: network that the embeddings are for.

    Raises:
        WeightsUnavailableError: the file is missing or broken, or an embedding has another size.
    """

    def __init__(self, path: Path, config: TransformerConfig) -> None:
        from hybridworldsim.generation.network.checkpoints import read_weights

        tensors = read_weights(path)
        self._path, self._empty = path, TextEmbedding.empty(config)
        self._embeddings: dict[str, TextEmbedding] = {}
        for name in sorted(tensors):
            caption, _, part = name.rpartition("/")
            if part != "tokens":
                continue
            tokens, pooled = tensors[name], tensors.get(f"{caption}/pooled")
            wanted = f"(M, {config.text_channels}) and ({config.pooled_channels},)"
            if (
                pooled is None
                or tokens.dim() != 2
                or tokens.shape[1] != config.text_channels
                or pooled.shape != self._empty.pooled.shape
            ):
                raise WeightsUnavailableError(f"the embedding of {caption!r} does not fit", file=path, expected=wanted)
            self._embeddings[caption] = TextEmbedding(tokens.float(), pooled.float())

    def __call__(self, caption: str) -> TextEmbedding:
        """The embedding of a caption; that of an empty one need not be in the file.

        Raises:
            UsageError: the file has no such caption.
        """
        if caption in self._embeddings:
            return self._embeddings[caption]
        if not caption:
            return self._empty
        raise UsageError(
            f"no embedding of {caption!r}", file=self._path,
            expected=f"one of its {len(self._embeddings)} captions, or no text",
            remedy="embed it, and add it to the file",
        )  # fmt: skip
