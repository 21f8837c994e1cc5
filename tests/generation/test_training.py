"""Training: bit-exact resumption, several processes, and what the losses are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list
from hybridworldsim.generation.devices import Precision, repeating_exactly
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.layout.images import draw_layout
from hybridworldsim.generation.model_files import read_autoencoder, read_generator, trained_rates, write_autoencoder
from hybridworldsim.generation.network.configuration import AdapterConfig, TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.flow import Weighting
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, GeneratorTrainer
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
from hybridworldsim.generation.training.samples import write_samples
from hybridworldsim.generation.training.windows import ClipWindows, encode_clip
from hybridworldsim.training.run.exhaustion import exhausted_memory_named
from hybridworldsim.training.run.state import dump, load
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress
from tests.generation.clips import make_clip, write_clips
from tests.generation.trained import CODEC, NETWORK, T
from tests.interruption import InterruptingProgress

AS_FRAMES = replace(
    NETWORK, reference_channels=0, temporal_layers=(1,), causal=True, layout=AdapterConfig(4, 8, scales=(1,))
)
OPTIONS = TrainingOptions(
    steps=6,
    autoencoder_steps=5,
    settings=GeneratorSettings(NETWORK, T, batch=4, warmup=2, context_noise=0.3, drop_layout=0.5),
    autoencoder_settings=AutoencoderSettings(CODEC, batch=2, warmup=2),
)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clips(tmp_path_factory.mktemp("clips"))


@pytest.fixture(scope="module")
def trained(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "run"
    train_on_clips(clips, out, OPTIONS, NullProgress())
    return out


@pytest.mark.parametrize("after", [3, 5, 8])
def test_an_interrupted_training_gives_the_same_bytes(clips: Path, trained: Path, tmp_path: Path, after: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        train_on_clips(clips, tmp_path / "run", OPTIONS, InterruptingProgress(after))
    train_on_clips(clips, tmp_path / "run", OPTIONS, NullProgress())
    for part in ("autoencoder", "generator"):
        name = f"{part}/model.safetensors"
        assert (tmp_path / "run" / name).read_bytes() == (trained / name).read_bytes(), name


def test_a_finished_run_is_not_changed_and_another_one_is_refused(clips: Path, trained: Path) -> None:
    before = (trained / "generator/model.safetensors").stat().st_mtime_ns
    train_on_clips(clips, trained, OPTIONS, NullProgress())
    assert (trained / "generator/model.safetensors").stat().st_mtime_ns == before
    with pytest.raises(UsageError, match="a run of other settings began here"):
        train_on_clips(clips, trained, replace(OPTIONS, seed=1), NullProgress())


def test_the_run_holds_models_and_curves(trained: Path) -> None:
    network, references = read_generator(trained / "generator/model.safetensors")
    assert network.config == NETWORK
    assert references == T
    assert trained_rates(trained / "generator/model.safetensors") == (5.0, 5.0)
    rows = (trained / "generator/curves.csv").read_text().splitlines()
    assert rows[0] == "step,progress,core_s,wall_s,velocity"
    assert len(rows) == 1 + OPTIONS.steps
    assert read_autoencoder(trained / "autoencoder/model.safetensors").settings == CODEC


@pytest.mark.parametrize(
    ("config", "weighting"),
    [(NETWORK, "velocity"), (NETWORK, "x0"), (AS_FRAMES, "epsilon")],
    ids=["velocity", "x0", "frames"],
)
def test_a_generator_learns_one_window_by_heart(config: TransformerConfig, weighting: Weighting) -> None:
    settings = GeneratorSettings(config, T, weighting=weighting, batch=4, warmup=1, learning_rate=5e-3)
    windows = ClipWindows([make_clip(frames=T + 1)], TinyAutoencoder(CODEC), config, OWN_STYLE, T)
    trainer = GeneratorTrainer(settings, windows, 1000)
    # A step of the same number has the same noise.
    first, *_, last = [[trainer.step(number)[weighting] for number in range(5)] for _ in range(8)]
    assert sum(last) < 0.8 * sum(first)


def test_a_batch_may_be_computed_in_parts() -> None:
    windows = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    whole, parts = (
        GeneratorTrainer(GeneratorSettings(NETWORK, T, batch=4, accumulate=count), windows, 10) for count in (1, 4)
    )
    losses, counted = [], []
    for trainer in (whole, parts):
        bias = trainer.network.proj_out.bias
        gradients: list[torch.Tensor] = []
        bias.register_hook(lambda gradient, into=gradients: into.append(gradient.clone()))
        losses.append(trainer.step(0)["velocity"])
        counted.append(len(gradients))
        # The step is that of the sum over the parts; its norm is limited.
        total = torch.stack(gradients).sum(dim=0)
        assert bias.grad is not None
        torch.testing.assert_close(bias.grad / bias.grad.norm(), total / total.norm(), rtol=1e-4, atol=1e-6)
    assert counted == [1, 4]
    # The same windows with other noise: the loss is a mean over the parts.
    assert 0.5 < losses[1] / losses[0] < 2.0
    with pytest.raises(UsageError, match="a batch of 4 in 3 parts"):
        GeneratorSettings(NETWORK, T, batch=4, accumulate=3)
    GeneratorSettings(NETWORK, T, batch=4, accumulate=2).require_shares(2)
    with pytest.raises(UsageError, match="2 processes in 4 parts"):
        GeneratorSettings(NETWORK, T, batch=4, accumulate=4).require_shares(2)


def test_the_model_is_the_average_of_its_steps() -> None:
    windows = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    trainer = GeneratorTrainer(GeneratorSettings(NETWORK, T, batch=1, warmup=1, ema=0.25), windows, 10)
    wanted = [one.detach().clone() for one in trainer.network.parameters()]
    for number, decay in enumerate((1 / 10, 2 / 11, 0.25, 0.25)):
        trainer.step(number)
        wanted = [decay * one + (1 - decay) * new.detach() for one, new in zip(wanted, trainer.network.parameters())]
    for found, one in zip(trainer.averaged_network().parameters(), wanted):
        torch.testing.assert_close(found, one, rtol=1e-5, atol=1e-7)


def test_half_precision_is_that_of_the_computation_only() -> None:
    windows = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    settings = GeneratorSettings(NETWORK, T, batch=2)
    trainers = [GeneratorTrainer(replace(settings, precision=name), windows, 10) for name in ("float32", "bf16")]
    full, half = (trainer.step(0)["velocity"] for trainer in trainers)
    assert full != half == pytest.approx(full, rel=0.02)
    assert {one.dtype for one in trainers[1].network.parameters()} == {torch.float32}


def test_a_sheet_shows_truth_background_and_sample(tmp_path: Path) -> None:
    clip, codec = make_clip(), TinyAutoencoder(CODEC)
    windows = ClipWindows([clip], codec, NETWORK, OWN_STYLE, T)
    network = Transformer(NETWORK).eval().requires_grad_(False)
    write_samples(tmp_path, "00000001", lambda: network, windows, codec, count=2, steps=1)
    (height, width), views = clip.size_px, len(clip.views)
    sheet = cv2.imread(str(tmp_path / "00000001.png"))[::2, ::2, ::-1]
    assert sheet.shape == (2 * height, 3 * views * width, 3)
    # The second row is of the last window.
    background = np.concatenate(list(clip.background[-1]), axis=1)
    np.testing.assert_array_equal(sheet[height:, views * width : 2 * views * width], background)


def test_absent_views_do_not_count() -> None:
    clip = make_clip()
    present = clip.present.copy()
    present[:, 1] = False
    noise = np.random.default_rng(0).integers(0, 256, clip.images[:, 1].shape, np.uint8)
    other = clip.images.copy()
    other[:, 1] = noise
    losses = []
    for images in (clip.images, other):
        torch.manual_seed(1)
        windows = ClipWindows(
            [replace(clip, images=images, present=present)], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T
        )
        losses.append(GeneratorTrainer(GeneratorSettings(NETWORK, T), windows, 10).step(0)["velocity"])
    assert losses[0] == losses[1]


def test_windows_hold_the_frames_before_the_target() -> None:
    clip, codec = make_clip(), TinyAutoencoder(CODEC)
    windows = ClipWindows([clip], codec, NETWORK, OWN_STYLE, T)
    assert len(windows) == len(clip) - T
    latents = encode_clip(clip, codec)
    batch = windows.batch([3])
    assert torch.equal(batch.target[0, 0], latents[3 + T])
    assert torch.equal(batch.references[0], latents[3 : 3 + T])
    assert batch.conditions.layout is not None
    for place, frame in enumerate(range(3, 3 + T + 1)):
        drawn = draw_layout(clip.boxes.at(frame), clip.intrinsics, clip.ego_SE3_camera, clip.size_px, OWN_STYLE)
        found = batch.conditions.layout[0, 0, :, 4 * place : 4 * place + 4].numpy()
        np.testing.assert_allclose(found, drawn, atol=0.5 / 255.0 + 1e-6)
        assert drawn.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latent_channels": 3, "reference_channels": 6}, "an autoencoder with 4 channels"),
        ({"reference_channels": 12}, "2 references for a network with 12 further channels"),
        ({"layout": AdapterConfig(8, 8, scales=(1,))}, "layouts of 3 x 4 channels"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ClipWindows([make_clip()], TinyAutoencoder(CODEC), replace(NETWORK, **change), OWN_STYLE, T)  # type: ignore[arg-type]


def test_clips_that_are_too_short_or_of_another_rig_are_refused() -> None:
    codec = TinyAutoencoder(CODEC)
    with pytest.raises(DatasetError, match="2 frames; expected at least 3"):
        ClipWindows([make_clip(frames=T)], codec, NETWORK, OWN_STYLE, T)
    other = replace(make_clip("clip-1"), views=("a", "b"))
    with pytest.raises(DatasetError, match="clip-1: views a, b"):
        ClipWindows([make_clip(), other], codec, NETWORK, OWN_STYLE, T)


def lower(clip: Clip, height: int) -> Clip:
    """The upper rows of a clip's images."""
    return replace(clip, images=clip.images[:, :, :height], background=clip.background[:, :, :height], tracks=None)


@pytest.mark.parametrize(
    ("unfit", "message"),
    [
        ([make_clip(frames=T)], "the longest clip has 2 frames"),
        ([make_clip(), lower(make_clip("clip-1"), 8)], "clip-1: views left, right of 24 x 8 px"),
        ([make_clip(), replace(make_clip("clip-1"), views=("a", "b"))], "clip-1: views a, b of 24 x 16 px"),
        # Latents have 4 pixels along a side, tokens 8.
        ([lower(make_clip(), 12)], "clip-0: images of 24 x 12 px; expected multiples of 8 px along both sides"),
    ],
)
def test_unfit_clips_are_named_before_an_autoencoder_is_trained(
    tmp_path: Path, unfit: list[Clip], message: str
) -> None:
    for clip in unfit:
        write_clip(tmp_path / "clips", clip)
    write_list(tmp_path / "clips", ClipList(source="test", training=tuple(one.clip_id for one in unfit), test=()))
    with pytest.raises(DatasetError, match=message) as caught:
        train_on_clips(tmp_path / "clips", tmp_path / "run", OPTIONS, NullProgress())
    assert caught.value.file == str(tmp_path / "clips") and caught.value.remedy
    assert not (tmp_path / "run").exists()


def test_exhausted_memory_is_named(clips: Path, trained: Path, tmp_path: Path) -> None:
    """A layer of more than 280 TB: no processor has the addresses for it."""
    huge = replace(NETWORK, head_channels=1 << 27)
    options = replace(
        OPTIONS,
        settings=replace(OPTIONS.settings, network=huge),
        autoencoder=trained / "autoencoder" / "model.safetensors",
    )
    with pytest.raises(DatasetError, match="too little memory"):
        train_on_clips(clips, tmp_path / "run", options, NullProgress())
    assert not (tmp_path / "run" / "generator" / "model.safetensors").exists()


@pytest.mark.parametrize(
    "error", [torch.OutOfMemoryError("CUDA out of memory"), MemoryError(), RuntimeError("DefaultCPUAllocator: no")]
)
def test_exhausted_memory_is_told_from_other_errors(error: Exception) -> None:
    with pytest.raises(DatasetError, match="too little memory") as caught, exhausted_memory_named("cuda:1", "less"):
        raise error
    assert (caught.value.place, caught.value.remedy) == ("cuda:1", "less")
    with pytest.raises(RuntimeError, match="shapes"), exhausted_memory_named("cpu", "less"):
        raise RuntimeError("shapes differ")


def test_a_device_that_does_not_exist_is_named_before_anything_is_written(clips: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no device 'banana'") as caught:
        train_on_clips(clips, tmp_path / "run", replace(OPTIONS, device="banana"), NullProgress())
    assert caught.value.place == "--device" and not (tmp_path / "run").exists()


def test_an_autoencoder_that_does_not_fit_leaves_no_folder(clips: Path, trained: Path, tmp_path: Path) -> None:
    wrong = replace(OPTIONS, autoencoder=trained / "generator" / "model.safetensors")
    with pytest.raises(DatasetError, match="of format 'mirror-generator/1'"):
        train_on_clips(clips, tmp_path / "run", wrong, NullProgress())
    write_autoencoder(tmp_path / "other.safetensors", TinyAutoencoder(replace(CODEC, channels=2)))
    wrong = replace(OPTIONS, autoencoder=tmp_path / "other.safetensors")
    with pytest.raises(UsageError, match="an autoencoder with 2 channels") as caught:
        train_on_clips(clips, tmp_path / "run", wrong, NullProgress())
    assert (caught.value.file, caught.value.place) == (str(tmp_path / "other.safetensors"), "--autoencoder")
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_is_restored_to_the_device_of_the_network() -> None:
    """A checkpoint is read to the processor; the network and Adam's moments stay where they were."""
    layer = torch.nn.Linear(2, 3)
    optimizer = torch.optim.AdamW(layer.parameters(), fused=True)
    layer(torch.ones(1, 2)).sum().backward()
    optimizer.step()
    state = {name: tensor.clone() for name, tensor in dump(layer, optimizer).items()}
    for fused in (True, False):
        elsewhere = torch.nn.Linear(2, 3, device="meta")
        other = torch.optim.AdamW(elsewhere.parameters(), fused=fused)
        load(elsewhere, state, other)
        assert {one.device.type for one in elsewhere.parameters()} == {"meta"}
        for moments in other.state.values():
            devices = {name: tensor.device.type for name, tensor in moments.items()}
            assert devices == {"step": "meta" if fused else "cpu", "exp_avg": "meta", "exp_avg_sq": "meta"}


@pytest.mark.cuda
@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_an_interrupted_training_on_a_gpu_gives_the_same_numbers(precision: Precision) -> None:
    with repeating_exactly("cuda"):
        windows = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
        settings = GeneratorSettings(NETWORK, T, batch=2, precision=precision, recompute=True, self_rollout=0.5)
        whole, first, second = (GeneratorTrainer(settings, windows, 6, device="cuda") for _ in range(3))
        for number in range(6):
            whole.step(number)
        for number in range(3):
            first.step(number)
        second.restore({name: tensor.cpu().clone() for name, tensor in first.state().items()})
        for number in range(3, 6):
            second.step(number)
    found = second.state()
    assert all(torch.equal(tensor, found[name]) for name, tensor in whole.state().items())
