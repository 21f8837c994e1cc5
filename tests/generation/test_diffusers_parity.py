"""Blocks against those of diffusers, on the same random weights; skipped where diffusers is not installed."""

from __future__ import annotations

from types import ModuleType

import pytest
import torch
from torch import Tensor, nn

from hybridworldsim.generation.network.adapter import ImageAdapter
from hybridworldsim.generation.network.configuration import AdapterConfig
from hybridworldsim.generation.network.embeddings import PatchEmbedding, StepTextEmbedding
from hybridworldsim.generation.network.joint_block import FeedForward, JointBlock, Modulation, normalise
from hybridworldsim.generation.network.mixing_block import MixingAttention

WIDTH, HEADS = 32, 2


@pytest.fixture(scope="module")
def diffusers() -> ModuleType:
    return pytest.importorskip("diffusers", reason="diffusers is not installed (extra: generation)")


def share_weights(theirs: nn.Module, ours: nn.Module) -> None:
    """Random weights for both; their names are the same."""
    generator = torch.Generator().manual_seed(0)
    state = {name: 0.3 * torch.randn(tensor.shape, generator=generator) for name, tensor in theirs.state_dict().items()}
    theirs.load_state_dict(state)
    ours.load_state_dict(state)


def random(*shape: int, seed: int = 1) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("dual", [True, False])
@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize("norm", [True, False])
def test_joint_block(diffusers: ModuleType, dual: bool, last: bool, norm: bool) -> None:
    from diffusers.models.attention import JointTransformerBlock

    theirs = JointTransformerBlock(
        WIDTH,
        HEADS,
        WIDTH // HEADS,
        context_pre_only=last,
        qk_norm="rms_norm" if norm else None,
        use_dual_attention=dual,
    )
    ours = JointBlock(WIDTH, HEADS, norm=norm, dual=dual, last=last)
    share_weights(theirs, ours)
    image, text, condition = random(2, 6, WIDTH), random(2, 3, WIDTH, seed=2), random(2, WIDTH, seed=3)
    with torch.no_grad():
        text_out, image_out = theirs(image, text, condition)
        found = ours(image, text, condition)
    torch.testing.assert_close(found[0], image_out, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(found[1], text if last else text_out, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("norm", [True, False])
def test_mixing_attention(diffusers: ModuleType, norm: bool) -> None:
    from diffusers.models.attention_processor import Attention

    theirs = Attention(query_dim=WIDTH, heads=HEADS, dim_head=WIDTH // HEADS, qk_norm="rms_norm" if norm else None)
    ours = MixingAttention(WIDTH, HEADS, norm=norm)
    share_weights(theirs, ours)
    tokens, mask = random(2, 5, WIDTH), torch.ones(5, 5).tril().bool()
    with torch.no_grad():
        expected = theirs(tokens, attention_mask=mask[None].expand(2, -1, -1))
        found = ours(tokens, ours.project(tokens), mask)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("gated", "name"), [(True, "geglu"), (False, "gelu-approximate")])
def test_feed_forward(diffusers: ModuleType, gated: bool, name: str) -> None:
    from diffusers.models.attention import FeedForward as Theirs

    theirs, ours = Theirs(WIDTH, dim_out=WIDTH, activation_fn=name), FeedForward(WIDTH, gated=gated)
    share_weights(theirs, ours)
    with torch.no_grad():
        torch.testing.assert_close(ours(random(2, 3, WIDTH)), theirs(random(2, 3, WIDTH)), rtol=1e-5, atol=1e-5)


def test_patches_and_their_positions(diffusers: ModuleType) -> None:
    from diffusers.models.embeddings import PatchEmbed

    theirs = PatchEmbed(8, 8, patch_size=2, in_channels=4, embed_dim=WIDTH, pos_embed_max_size=12)
    ours = PatchEmbedding(4, WIDTH, 2, 12, 4)
    torch.testing.assert_close(ours.pos_embed, theirs.pos_embed, rtol=1e-6, atol=1e-6)
    share_weights(theirs, ours)
    with torch.no_grad():
        torch.testing.assert_close(ours(random(2, 4, 6, 10)), theirs(random(2, 4, 6, 10)), rtol=1e-5, atol=1e-5)


def test_time_step_and_text(diffusers: ModuleType) -> None:
    from diffusers.models.embeddings import CombinedTimestepTextProjEmbeddings

    theirs, ours = CombinedTimestepTextProjEmbeddings(WIDTH, 5), StepTextEmbedding(WIDTH, 5)
    share_weights(theirs, ours)
    timestep, pooled = torch.tensor([0.0, 0.5, 321.5, 1000.0]), random(4, 5)
    with torch.no_grad():
        torch.testing.assert_close(ours(timestep, pooled), theirs(timestep, pooled), rtol=1e-5, atol=1e-5)


def test_last_normalisation(diffusers: ModuleType) -> None:
    from diffusers.models.normalization import AdaLayerNormContinuous

    theirs, ours = AdaLayerNormContinuous(WIDTH, WIDTH, elementwise_affine=False, eps=1e-6), Modulation(WIDTH, 2)
    share_weights(theirs, ours)
    tokens, condition = random(2, 5, WIDTH), random(2, WIDTH, seed=2)
    with torch.no_grad():
        scale, shift = ours(condition)
        torch.testing.assert_close(
            normalise(tokens) * (1 + scale) + shift, theirs(tokens, condition), rtol=1e-5, atol=1e-5
        )


def test_adapter_blocks(diffusers: ModuleType) -> None:
    from diffusers.models.adapter import AdapterBlock

    ours = ImageAdapter(AdapterConfig(3, WIDTH, scales=(1, 1)), 16, WIDTH)
    theirs = nn.ModuleList([AdapterBlock(192, WIDTH, 2, down=True), AdapterBlock(WIDTH, WIDTH, 2)])
    share_weights(theirs, ours.body)
    for convolution in ours.zero_convs:
        nn.init.dirac_(convolution.weight)
    images = random(2, 3, 32, 48)
    with torch.no_grad():
        expected, features = nn.functional.pixel_unshuffle(images, 8), ours(images)
        for block, feature in zip(theirs, features):
            expected = block(expected)
            torch.testing.assert_close(feature, expected.flatten(2).transpose(1, 2), rtol=1e-5, atol=1e-5)
