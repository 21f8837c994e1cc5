"""Cached embeddings of captions."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from hybridworldsim.generation.text import CachedEmbeddings
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError
from tests.generation.builders import SHORT


def test_embeddings_are_found_by_caption(tmp_path: Path) -> None:
    tokens, pooled = torch.randn(7, SHORT.text_channels), torch.randn(SHORT.pooled_channels)
    save_file({"a wet street/tokens": tokens, "a wet street/pooled": pooled}, tmp_path / "text.safetensors")
    embeddings = CachedEmbeddings(tmp_path / "text.safetensors", SHORT)
    assert torch.equal(embeddings("a wet street").tokens, tokens)
    assert torch.equal(embeddings("a wet street").pooled, pooled)
    assert embeddings("").tokens.shape == (0, SHORT.text_channels)
    with pytest.raises(UsageError, match="no embedding of 'fog'"):
        embeddings("fog")


@pytest.mark.parametrize("channels", [5, 7])
def test_embeddings_of_another_size_are_refused(tmp_path: Path, channels: int) -> None:
    save_file({"x/tokens": torch.zeros(2, channels), "x/pooled": torch.zeros(5)}, tmp_path / "text.safetensors")
    with pytest.raises(WeightsUnavailableError, match="the embedding of 'x' does not fit"):
        CachedEmbeddings(tmp_path / "text.safetensors", SHORT)
