"""Autoencoders: shapes, statistics, training, and those of diffusers by key."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from hybridworldsim.generation.autoencoder.codec import to_bytes, to_tensor
from hybridworldsim.generation.autoencoder.of_diffusers import load_autoencoder
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.training.autoencoder_trainer import (
    AutoencoderSettings,
    AutoencoderTrainer,
    reconstruction_psnr_db,
)
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError
from tests.generation.clips import make_clip


@pytest.mark.parametrize("halvings", [1, 2, 3])
def test_latents_have_the_stated_shape(halvings: int) -> None:
    model = TinyAutoencoder(TinySettings(channels=5, width=4, halvings=halvings))
    images = torch.rand(2, 3, 16, 24)
    latents = model.encode(images)
    assert latents.shape == (2, 5, 16 // model.stride, 24 // model.stride)
    assert model.decode(latents).shape == images.shape
    with pytest.raises(UsageError, match="latents of 4 channels"):
        model.decode(latents[:, :4])
    with pytest.raises(UsageError, match="multiples of"):
        model.encode(images[..., :-1])


def test_normalised_latents_decode_to_the_same_images() -> None:
    torch.manual_seed(0)
    model = TinyAutoencoder(TinySettings(width=8))
    images = torch.rand(8, 3, 16, 24)
    with torch.no_grad():
        before = model.decode(model.encode(images))
        for _ in range(2):
            model.set_statistics(model.encode(images))
            latents = model.encode(images)
            torch.testing.assert_close(latents.mean(dim=(0, 2, 3)), torch.zeros(8), rtol=0, atol=1e-4)
            torch.testing.assert_close(latents.std(dim=(0, 2, 3)), torch.ones(8), rtol=0, atol=1e-4)
        torch.testing.assert_close(model.decode(latents), before, rtol=1e-4, atol=1e-4)
    with pytest.raises(UsageError, match="constant"):
        model.set_statistics(torch.zeros(2, 8, 4, 4))


def test_training_improves_the_reconstruction() -> None:
    images = make_clip().images.reshape(-1, 16, 24, 3)
    trainer = AutoencoderTrainer(AutoencoderSettings(TinySettings(width=16), warmup=5), images, 60)
    before = reconstruction_psnr_db(trainer.model, images)
    for number in range(60):
        trainer.step(number)
    model = trainer.finish()
    assert reconstruction_psnr_db(model, images) > before + 3.0


def test_psnr_is_that_of_the_mean_of_each_image() -> None:
    images = make_clip().images[:2].reshape(-1, 16, 24, 3)
    model = TinyAutoencoder(TinySettings(width=4))
    with torch.no_grad():
        decoded = model.decode(model.encode(to_tensor(images)))
    errors = (np.clip(decoded.numpy(), 0, 1) - to_tensor(images).numpy()) ** 2
    expected = np.mean([-10.0 * np.log10(error.mean()) for error in errors])
    assert reconstruction_psnr_db(model, images) == pytest.approx(expected, abs=1e-4)


def test_bytes_survive() -> None:
    images = np.random.default_rng(0).integers(0, 256, (2, 4, 6, 3), np.uint8)
    assert np.array_equal(to_bytes(to_tensor(images)), images)


@pytest.fixture(scope="module")
def diffusers() -> ModuleType:
    return pytest.importorskip("diffusers", reason="diffusers is not installed (extra: generation)")


def saved_autoencoder(folder: Path, model: torch.nn.Module, name: str) -> None:
    folder.mkdir(exist_ok=True)
    config = {key: value for key, value in model.config.items() if not key.startswith("_")}
    (folder / "config.json").write_text(json.dumps({"_class_name": name, **config}))
    save_file(model.state_dict(), folder / "diffusion_pytorch_model.safetensors")


def test_autoencoder_kl_is_loaded_by_key_with_shift_and_scale(diffusers: ModuleType, tmp_path: Path) -> None:
    theirs = diffusers.AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 2, up_block_types=("UpDecoderBlock2D",) * 2,
        block_out_channels=(4, 4), norm_num_groups=2, latent_channels=3, use_quant_conv=False,
        use_post_quant_conv=False, shift_factor=0.06, scaling_factor=1.5,
    ).eval()  # fmt: skip
    saved_autoencoder(tmp_path / "vae", theirs, "AutoencoderKL")
    codec = load_autoencoder(tmp_path / "vae")
    assert (codec.channels, codec.stride) == (3, 2)
    images = torch.rand(1, 3, 8, 8)
    with torch.no_grad():
        latents = codec.encode(images)
        torch.testing.assert_close(latents, (theirs.encode(2 * images - 1).latent_dist.mode() - 0.06) * 1.5)
        torch.testing.assert_close(codec.decode(latents), theirs.decode(latents / 1.5 + 0.06).sample / 2 + 0.5)
    with pytest.raises(UsageError, match="latents of 4 channels"):
        codec.decode(torch.zeros(1, 4, 4, 4))


def test_autoencoder_tiny_is_loaded_and_others_are_refused(diffusers: ModuleType, tmp_path: Path) -> None:
    theirs = diffusers.AutoencoderTiny(
        encoder_block_out_channels=(4, 4), decoder_block_out_channels=(4, 4), num_encoder_blocks=(1, 1),
        num_decoder_blocks=(1, 1), latent_channels=3,
    )  # fmt: skip
    folder = tmp_path / "vae"
    saved_autoencoder(folder, theirs, "AutoencoderTiny")
    codec = load_autoencoder(folder)
    assert (codec.channels, codec.stride) == (3, 2)
    images = torch.rand(1, 3, 8, 8)
    with torch.no_grad():
        torch.testing.assert_close(codec.encode(images), theirs.eval().encode(2 * images - 1).latents)
        assert codec.decode(codec.encode(images)).shape == images.shape
    save_file({"other": torch.zeros(1)}, folder / "diffusion_pytorch_model.safetensors")
    with pytest.raises(WeightsUnavailableError, match="Missing key"):
        load_autoencoder(folder)
    (folder / "config.json").write_text('{"_class_name": "AutoencoderOther"}')
    with pytest.raises(WeightsUnavailableError, match="an autoencoder 'AutoencoderOther'"):
        load_autoencoder(folder)
    with pytest.raises(WeightsUnavailableError, match="cannot be read"):
        load_autoencoder(tmp_path / "nowhere")
