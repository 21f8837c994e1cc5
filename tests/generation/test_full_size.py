"""The generator at the paper's size computes on any device: seven views of 448 x 256, by tensors without numbers."""

from __future__ import annotations

import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.network.configuration import SMALL, TINY_REFERENCES
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.costs import empty_conditions
from hybridworldsim.generation.training.generator_trainer import predict_velocity

SIZE, VIEWS = (256, 448), 7
GRID = [side // SMALL.latent_stride for side in SIZE]


@pytest.mark.parametrize("device", ["meta", pytest.param("cuda", marks=pytest.mark.cuda)])
def test_a_training_step_of_full_size_computes_where_its_network_is(device: str) -> None:
    frames = 1 if SMALL.reference_channels else 1 + TINY_REFERENCES
    with torch.device(device):
        network = Transformer(SMALL)
        references, noisy = (
            torch.zeros(1, count, VIEWS, SMALL.latent_channels, *GRID) for count in (TINY_REFERENCES, 1)
        )
        level, reference_level = torch.zeros(1, 1, VIEWS), torch.zeros(1, TINY_REFERENCES, VIEWS)
    conditions = empty_conditions(SMALL, SIZE, VIEWS, device, frames=frames)
    velocity = predict_velocity(network, noisy, references, conditions, level, reference_level)
    assert velocity.shape == noisy.shape and velocity.device.type == device
    velocity.square().mean().backward()
    gradients = [one.grad for one in network.parameters() if one.grad is not None]
    # Those that read text get none: there is none.
    assert len(gradients) > 250 and {one.device.type for one in gradients} == {device}


@pytest.mark.parametrize("device", ["meta", pytest.param("cuda", marks=pytest.mark.cuda)])
@torch.inference_mode()
def test_a_frame_of_full_size_is_sampled_and_decoded_where_its_network_is(device: str) -> None:
    with torch.device(device):
        network, codec = Transformer(SMALL), TinyAutoencoder(TinySettings(SMALL.latent_channels))
        references = torch.zeros(1, TINY_REFERENCES, VIEWS, SMALL.latent_channels, *GRID)
        noise = torch.zeros(1, 1, VIEWS, SMALL.latent_channels, *GRID)
    conditions = empty_conditions(SMALL, SIZE, VIEWS, device)
    latents = sample_frame(network, references, conditions, noise, SamplerSettings(4))
    images = codec.decode(latents.flatten(0, 2))
    assert images.shape == (VIEWS, 3, *SIZE) and images.device.type == device
