"""Self-rollout: references of training windows that the network generated itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.network.configuration import AdapterConfig, TransformerConfig
from hybridworldsim.generation.sampling.sampler import draw_noise
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, GeneratorTrainer
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
from hybridworldsim.generation.training.self_rollout import draw_self_rollout, roll_out_references
from hybridworldsim.generation.training.windows import ClipWindows, encode_clip
from mirror.errors import UsageError
from mirror.progress import NullProgress
from tests.generation.clips import FRAMES, make_clip, write_clips
from tests.generation.trained import CODEC, NETWORK, T
from tests.interruption import InterruptingProgress

AS_FRAMES = replace(
    NETWORK, reference_channels=0, temporal_layers=(1,), causal=True, layout=AdapterConfig(4, 8, scales=(1,))
)
ALWAYS = GeneratorSettings(NETWORK, T, batch=4, warmup=1, self_rollout=1.0)


def make_windows(config: TransformerConfig = NETWORK, clip: Clip | None = None) -> ClipWindows:
    torch.manual_seed(0)
    return ClipWindows([clip or make_clip()], TinyAutoencoder(CODEC), config, OWN_STYLE, T)


def train(settings: GeneratorSettings, steps: int = 2) -> tuple[list[float], list[Tensor]]:
    trainer = GeneratorTrainer(settings, make_windows(settings.network), 10)
    losses = [trainer.step(number)[settings.weighting] for number in range(steps)]
    return losses, [one.detach() for one in trainer.network.parameters()]


def test_without_self_rollout_training_is_what_it_was() -> None:
    plain = replace(ALWAYS, self_rollout=0.0, context_noise=0.3, drop_layout=0.5)
    # So rare that no window of these steps is chosen: all other random numbers must be the same.
    rare = replace(plain, self_rollout=1e-9)
    (losses, parameters), (others, same) = train(plain), train(rare)
    assert losses == others
    assert all(torch.equal(one, other) for one, other in zip(parameters, same, strict=True))
    assert losses != train(replace(plain, self_rollout=1.0))[0]
    # Runs that began before the option existed continue.
    assert not any("rollout" in name for name in plain.document)
    assert rare.document == {**plain.document, "self_rollout": 1e-9, "self_rollout_steps": 2}


@pytest.mark.parametrize("config", [NETWORK, AS_FRAMES], ids=["channels", "frames"])
def test_references_are_what_the_sampler_gives(config: TransformerConfig) -> None:
    """Frame by frame, each from the window that ends with it, with recorded seeds and the same noise."""
    windows, settings = make_windows(config), replace(ALWAYS, network=config)
    trainer = GeneratorTrainer(settings, windows, 10)
    trainer.step(0)
    # The window of number 4 has its target at frame 6; its references are frames 4 and 5, its seeds 2 and 3.
    number, frame = 4, 4 + T
    found = roll_out_references(trainer.network, windows.history(number), T, SamplerSettings(2), seed=11)
    torch.manual_seed(0)
    history = encode_clip(make_clip(), TinyAutoencoder(CODEC))[None, frame - 2 * T : frame]
    for place in range(T, 2 * T):
        noise = draw_noise(history[:, :1].shape, (11, place))
        conditions = windows.conditions(0, frame - 2 * T + place)
        with torch.no_grad():
            own = sample_frame(
                trainer.network, history[:, place - T : place], conditions, noise, SamplerSettings(2, cache=False)
            )
        history = torch.cat([history[:, :place], own, history[:, place + 1 :]], dim=1)
    torch.testing.assert_close(found, history[:, T:], rtol=1e-4, atol=1e-5)
    assert not torch.allclose(found, windows.batch([number]).references, atol=0.01)


def test_the_loss_is_that_of_these_references() -> None:
    """Training on recorded references that were replaced by the network's own output has the same loss."""
    trainer = GeneratorTrainer(ALWAYS, make_windows(), 10)
    network = trainer.network

    class Replaced(ClipWindows):
        def batch(self, numbers):  # type: ignore[no-untyped-def]
            batch = super().batch(numbers)
            seeds = [draw_self_rollout(0, 0, place, 1.0) for place in range(len(numbers))]
            own = [
                roll_out_references(network, self.history(number), T, SamplerSettings(2), int(seed or 0))
                for number, seed in zip(numbers, seeds)
            ]
            return replace(batch, references=torch.cat(own))

    torch.manual_seed(0)
    replaced = Replaced([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    plain = GeneratorTrainer(replace(ALWAYS, self_rollout=0.0), replaced, 10)
    assert plain.step(0) == trainer.step(0)


def test_a_window_at_the_start_of_a_clip_has_as_much_of_its_own_output_as_there_is() -> None:
    windows = make_windows()
    network = GeneratorTrainer(ALWAYS, windows, 10).network
    for number, own in ((0, 0), (1, 1), (2, 2), (FRAMES - T - 1, 2)):
        recorded = windows.batch([number]).references
        found = roll_out_references(network, windows.history(number), T, SamplerSettings(1), seed=0)
        changed = [not torch.equal(found[:, place], recorded[:, place]) for place in range(T)]
        assert changed == [place >= T - own for place in range(T)]


def test_views_that_do_not_exist_keep_their_latents() -> None:
    clip = make_clip()
    present = clip.present.copy()
    present[4, 1] = False
    windows = make_windows(clip=replace(clip, present=present))
    network = GeneratorTrainer(ALWAYS, windows, 10).network
    recorded = windows.batch([4]).references
    found = roll_out_references(network, windows.history(4), T, SamplerSettings(1), seed=0)
    same = [[torch.equal(found[0, place, view], recorded[0, place, view]) for view in (0, 1)] for place in range(T)]
    assert same == [[False, True], [False, False]]


def test_a_rolled_out_window_costs_a_pass_for_each_step_of_each_reference() -> None:
    windows = make_windows(clip=make_clip(frames=2 * T + 1))
    passes = []
    for share in (0.0, 1.0):
        settings = replace(ALWAYS, batch=1, self_rollout=share, self_rollout_steps=3)
        trainer = GeneratorTrainer(settings, windows, 10)
        counted: list[bool] = []
        trainer.network.register_forward_hook(lambda *_, into=counted: into.append(torch.is_grad_enabled()))
        # All windows of the clip, some with fewer frames before them.
        for number in range(4):
            trainer.step(number)
        passes.append(counted)
    assert passes[0] == [True] * 4
    assert sum(passes[1]) == 4
    rolled = len(passes[1]) - 4
    assert rolled % 3 == 0 and 0 < rolled <= 4 * T * 3


def test_shares_are_kept_and_do_not_depend_on_the_parts_of_a_batch() -> None:
    drawn = [draw_self_rollout(3, step, place, 0.25) for step in range(500) for place in range(4)]
    assert sum(one is not None for one in drawn) / len(drawn) == pytest.approx(0.25, abs=0.03)
    assert len({one for one in drawn if one is not None}) == sum(one is not None for one in drawn)
    assert draw_self_rollout(3, 5, 1, 1.0) is not None and draw_self_rollout(3, 5, 1, 0.0) is None


def test_gradients_do_not_pass_through_the_rollout_and_exist_in_half_precision() -> None:
    losses, gradients = {}, {}
    for precision in ("float32", "bf16"):
        settings = replace(ALWAYS, precision=precision)  # type: ignore[arg-type]
        trainer = GeneratorTrainer(settings, make_windows(), 10)
        losses[precision] = trainer.step(0)["velocity"]
        gradients[precision] = {name for name, one in trainer.network.named_parameters() if one.grad is not None}
    assert losses["bf16"] == pytest.approx(losses["float32"], rel=0.03)
    assert gradients["bf16"] == gradients["float32"]


def test_an_interrupted_training_gives_the_same_bytes(tmp_path: Path) -> None:
    clips = write_clips(tmp_path / "clips", count=1)
    options = TrainingOptions(
        steps=3,
        autoencoder_steps=1,
        settings=replace(ALWAYS, self_rollout=0.5),
        autoencoder_settings=AutoencoderSettings(CODEC, batch=2, warmup=2),
    )
    whole = train_on_clips(clips, tmp_path / "whole", options, NullProgress())
    options = replace(options, autoencoder=whole.autoencoder)
    with pytest.raises(KeyboardInterrupt):
        train_on_clips(clips, tmp_path / "part", options, InterruptingProgress(2))
    part = train_on_clips(clips, tmp_path / "part", options, NullProgress())
    assert part.generator.read_bytes() == whole.generator.read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"self_rollout": 1.5}, "self_rollout 1.5"),
        ({"self_rollout": float("nan")}, "self_rollout nan"),
        ({"self_rollout_steps": 0}, "0 steps"),
    ],
)
def test_wrong_settings_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        replace(ALWAYS, **change)  # type: ignore[arg-type]
