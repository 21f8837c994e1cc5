"""Cached embeddings of captions, and captions in training windows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.captions import CachedCaptions, CachedEmbeddings, TextEmbedding, embedding_widths
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.conditions import frame_conditions
from hybridworldsim.generation.inference.windows import join_conditions
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.model_files import captioned_config, read_generator
from hybridworldsim.generation.network.configuration import AdapterConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.distillation import DistillationSettings
from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, predict_velocity
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips, with_text_of
from hybridworldsim.generation.training.windows import ClipWindows
from mirror.errors import UsageError
from mirror.progress import NullProgress
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import file_sha256
from tests.generation.builders import SHORT
from tests.generation.clips import make_clip, write_clips
from tests.generation.trained import CODEC, NETWORK, T

AS_FRAMES = replace(NETWORK, reference_channels=0, layout=AdapterConfig(4, 8, scales=(1,)))


def numbered(first: float, tokens: int = 2) -> dict[str, Tensor]:
    """Tokens and pooled text for `SHORT`, all numbers equal."""
    return {
        "tokens": torch.full((tokens, SHORT.text_channels), first),
        "pooled": torch.full((SHORT.pooled_channels,), first),
    }


def write(path: Path, **captions: dict[str, Tensor]) -> Path:
    save_file({f"{name}/{part}": one for name, parts in captions.items() for part, one in parts.items()}, path)
    return path


def test_embeddings_are_found_by_caption(tmp_path: Path) -> None:
    tokens, pooled = torch.randn(7, SHORT.text_channels), torch.randn(SHORT.pooled_channels)
    save_file({"a wet street/tokens": tokens, "a wet street/pooled": pooled}, tmp_path / "text.safetensors")
    embeddings = CachedEmbeddings(tmp_path / "text.safetensors", SHORT)
    assert torch.equal(embeddings("a wet street").tokens, tokens)
    assert torch.equal(embeddings("a wet street").pooled, pooled)
    assert embeddings("").tokens.shape == (0, SHORT.text_channels)
    with pytest.raises(UsageError, match="no embedding of 'fog'"):
        embeddings("fog")


NAN = torch.tensor([0.0, float("nan"), 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        (
            {"x/tokens": torch.zeros(2, 5), "x/pooled": torch.zeros(5)},
            r"'x' does not fit: pooled \(5,\), tokens \(2, 5",
        ),
        ({"x/tokens": torch.zeros(2, 7), "x/pooled": torch.zeros(5)}, r"expected tokens \(M, 6\) and pooled \(5,\)"),
        ({"x/tokens": torch.zeros(2, 6), "x/pooled": torch.zeros(6)}, r"'x' does not fit: pooled \(6,\)"),
        ({"x/tokens": torch.zeros(2, 6)}, r"'x' does not fit: tokens \(2, 6\)"),
        ({"x/pooled": torch.zeros(5)}, r"'x' does not fit: pooled \(5,\)"),
        ({"x/tokens": torch.zeros(2, 6), "x/pooled": NAN}, "x/pooled: numbers that are not finite"),
        ({"x/tokens": torch.zeros(2, 6, dtype=torch.int64), "x/pooled": torch.zeros(5)}, "x/tokens: numbers"),
        ({"tokens": torch.zeros(2, 6), "pooled": torch.zeros(5)}, "a tensor 'pooled'|a tensor 'tokens'"),
        ({"x/words": torch.zeros(2, 6)}, "a tensor 'x/words'"),
        ({}, "no embeddings"),
    ],
)
def test_files_that_do_not_fit_are_refused_by_name(tmp_path: Path, tensors: dict[str, Tensor], message: str) -> None:
    save_file(tensors, tmp_path / "text.safetensors")
    with pytest.raises(WeightsUnavailableError, match=message) as caught:
        CachedEmbeddings(tmp_path / "text.safetensors", SHORT)
    assert caught.value.file == str(tmp_path / "text.safetensors")


def test_captions_of_different_lengths_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "text.safetensors", left=numbered(1.0, 2), right=numbered(2.0, 3))
    with pytest.raises(WeightsUnavailableError, match="captions of 2 and 3 tokens"):
        CachedCaptions(path, SHORT)
    assert embedding_widths(path) == (SHORT.text_channels, SHORT.pooled_channels)
    with pytest.raises(WeightsUnavailableError, match="widths none and 5"):
        embedding_widths(write(tmp_path / "other.safetensors", left={"pooled": torch.zeros(5)}))


def test_the_most_specific_caption_of_a_view_is_used(tmp_path: Path) -> None:
    names = {"all": 1.0, "right": 2.0, "clip-0": 3.0, "clip-0/right": 4.0, "drive-5/left": 5.0}
    path = write(tmp_path / "text.safetensors", **{name: numbered(value) for name, value in names.items()})
    captions = CachedCaptions(path, SHORT)
    clip = make_clip()
    found = {
        (one.clip_id, view): float(captions(one, 0, view).pooled[0])
        for one in (clip, replace(clip, clip_id="other"), replace(clip, clip_id="third", drive_id="drive-5"))
        for view in clip.views
    }
    assert found == {
        ("clip-0", "left"): 3.0, ("clip-0", "right"): 4.0, ("other", "left"): 1.0, ("other", "right"): 2.0,
        ("third", "left"): 5.0, ("third", "right"): 2.0,
    }  # fmt: skip


def test_a_camera_without_a_caption_is_named(tmp_path: Path) -> None:
    captions = CachedCaptions(write(tmp_path / "text.safetensors", right=numbered(1.0)), SHORT)
    captions.require(("drive",), ["right"])
    with pytest.raises(UsageError, match=r"--captions: .*left, up"):
        captions.require(("drive",), ["left", "right", "up"])


def telling(clip: Clip, frame: int, view: str) -> TextEmbedding:
    """A caption that says of which clip, frame and view it is, for `NETWORK`."""
    said = torch.tensor([float(clip.clip_id[-1]), float(frame), float(clip.views.index(view))])
    return TextEmbedding(torch.stack([said, -said]), 10.0 * said)


def test_windows_have_the_captions_of_their_frames_and_views() -> None:
    clips = [make_clip("clip-0"), make_clip("clip-1", seed=1)]
    for config, frames in ((NETWORK, 1), (AS_FRAMES, T + 1)):
        windows = ClipWindows(clips, TinyAutoencoder(CODEC), config, OWN_STYLE, T, telling)
        per_clip = len(windows) // 2
        found = windows.batch([1, per_clip + 2]).conditions
        for row, last in ((0, T + 1), (1, T + 2)):
            for place, frame in enumerate(range(last - frames + 1, last + 1)):
                for view in range(2):
                    said = [float(row), float(frame), float(view)]
                    assert found.pooled[row, place, view].tolist() == [10.0 * one for one in said]
                    assert found.text[row, place, view].tolist() == [said, [-one for one in said]]
    # Of a self-rollout's frames too.
    history = windows.history(per_clip + 2).conditions
    assert [float(one.pooled[0, 0, 1, 1]) for one in history] == [10.0 * frame for frame in range(T + 2)]
    assert [float(one.pooled[0, 0, 1, 0]) for one in history] == [10.0] * (T + 2)


def test_training_with_captions_reaches_the_parameters_that_read_them() -> None:
    torch.manual_seed(0)
    network = Transformer(NETWORK)
    for captions, reached in ((telling, True), (None, False)):
        batch = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T, captions).batch([0])
        levels = torch.full((1, 1, 2), 0.5), torch.zeros((1, T, 2))
        network.zero_grad()
        predict_velocity(network, batch.target, batch.references, batch.conditions, *levels).square().sum().backward()
        gradient = network.context_embedder.weight.grad
        assert (gradient is not None and bool(gradient.any())) == reached
        assert batch.conditions.text.shape[-2] == (2 if reached else 0)


def test_captions_that_do_not_fit_are_named() -> None:
    clip, layout = make_clip(), torch.zeros(2, 4, 16, 24).numpy()

    def wide(clip: Clip, frame: int, view: str) -> TextEmbedding:
        return TextEmbedding(torch.zeros(2, 4), torch.zeros(3))

    def longer_on_the_right(clip: Clip, frame: int, view: str) -> TextEmbedding:
        return TextEmbedding(torch.zeros(2 + (view == "right"), 3), torch.zeros(3))

    def longer_later(clip: Clip, frame: int, view: str) -> TextEmbedding:
        return TextEmbedding(torch.zeros(2 + frame, 3), torch.zeros(3))

    with pytest.raises(UsageError, match="clip-0, frame 1, left: "):
        frame_conditions(clip, 1, AS_FRAMES, layout, wide)
    with pytest.raises(UsageError, match="clip-0, frame 1, right: "):
        frame_conditions(clip, 1, AS_FRAMES, layout, longer_on_the_right)
    with pytest.raises(UsageError, match="captions of 2 and 3 tokens"):
        join_conditions(AS_FRAMES, [frame_conditions(clip, one, AS_FRAMES, layout, longer_later) for one in (0, 1)])


def test_a_model_that_was_trained_with_captions_says_so(tmp_path: Path) -> None:
    clips, out, path = write_clips(tmp_path / "clips", count=1), tmp_path / "out", tmp_path / "text.safetensors"
    narrow = replace(GeneratorSettings(NETWORK, T, batch=1), network=replace(NETWORK, text_channels=1))
    save_file({"clip-0/tokens": torch.randn(2, 3), "clip-0/pooled": torch.randn(3)}, path)
    options = TrainingOptions(
        1, 1, settings=narrow, autoencoder_settings=AutoencoderSettings(CODEC, batch=2), captions=path
    )  # fmt: skip
    with pytest.raises(WeightsUnavailableError, match=r"expected tokens \(M, 1\)"):
        train_on_clips(clips, out, options, NullProgress())
    assert not out.exists()
    options = replace(options, settings=with_text_of(narrow, path))
    assert options.settings.network == NETWORK
    done = train_on_clips(clips, out, options, NullProgress())
    assert json.loads((out / "generator" / "run.json").read_text())["settings"]["captions"] == file_sha256(path)
    distilling = DistillationOptions(1, DistillationSettings(2, 4), replace(narrow, ema=0.9), captions=path)
    student, _ = distil_on_clips(
        clips, done.generator, done.autoencoder, tmp_path / "student", distilling, NullProgress()
    )  # fmt: skip
    for model in (done.generator, student):
        captioned_config(model)
        assert read_generator(model)[0].config == NETWORK
    # Other captions make another run; and it is no model of a training without.
    save_file({"clip-0/tokens": torch.randn(2, 3), "clip-0/pooled": torch.randn(3)}, path)
    with pytest.raises(UsageError, match="a run of other settings began here"):
        train_on_clips(clips, out, options, NullProgress())
    save_file({"left/tokens": torch.randn(2, 3), "left/pooled": torch.randn(3)}, path)
    with pytest.raises(UsageError, match="no caption for right"):
        train_on_clips(clips, tmp_path / "other", options, NullProgress())
    distilling = replace(distilling, captions=None)
    plain, _ = distil_on_clips(clips, done.generator, done.autoencoder, tmp_path / "plain", distilling, NullProgress())
    with pytest.raises(UsageError, match="trained without text"):
        captioned_config(plain)
    # The same parameters at first and the same noise, without the text.
    assert plain.read_bytes() != student.read_bytes()
