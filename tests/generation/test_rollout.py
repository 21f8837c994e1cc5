"""Rollouts: windows, seeds, references as frames and as channels."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame, target_velocity
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.inference.windows import join_conditions, seed_frames
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.sampler import draw_noise
from mirror.errors import DatasetError, UsageError
from tests.generation.builders import make_conditions, make_network
from tests.generation.rollout_inputs import AS_CHANNELS, AS_FRAMES, T, seeds, single_frames

CONFIGS = {"channels": AS_CHANNELS, "frames": AS_FRAMES}


@pytest.mark.parametrize("name", CONFIGS)
def test_each_frame_is_generated_from_the_frames_before_it(name: str) -> None:
    network, frames = make_network(CONFIGS[name]), single_frames(T + 4)
    settings = SamplerSettings(steps=2)
    rollout = SequenceRollout(network, seeds(), frames[:T], settings, seed=5, first=10)
    generated = [rollout.step(conditions) for conditions in frames[T:]]
    history = torch.cat([seeds(), *generated], dim=1)
    for place, latents in enumerate(generated):
        # The same frame on its own, with all features and without cached keys.
        window = join_conditions(network.config, frames[place : place + T + 1])
        noise = draw_noise(latents.shape, (5, 10 + place)).double()
        alone = sample_frame(network, history[:, place : place + T], window, noise, replace(settings, cache=False))
        torch.testing.assert_close(latents, alone, rtol=1e-9, atol=1e-9)
    assert rollout.frame == 14


@pytest.mark.parametrize("name", CONFIGS)
def test_adapters_run_once_per_frame_and_references_once_for_all_steps(name: str) -> None:
    network, frames = make_network(CONFIGS[name]), single_frames(T + 2)
    adapted: list[int] = []
    passes: list[int] = []
    for module, counts in ((network.background_adapter, adapted), (network.transformer_blocks[0], passes)):
        # Frames of two views each.
        module.register_forward_hook(lambda _, given, __, counts=counts: counts.append(len(given[0]) // 2))
    rollout = SequenceRollout(network, seeds(), frames[:T], SamplerSettings(steps=3))
    for conditions in frames[T:]:
        rollout.step(conditions)
    if name == "channels":
        assert (adapted, passes) == ([1, 1], [1, 1, 1] * 2)
    else:
        # The references in one pass, whose keys and values all steps use; their features are those of their own frame.
        assert (adapted, passes) == ([1] * (T + 2), [T, 1, 1, 1] * 2)


@pytest.mark.parametrize("name", CONFIGS)
def test_every_reference_and_every_layout_counts(name: str) -> None:
    network, frames = make_network(CONFIGS[name]), single_frames(T + 1)
    settings, noise = SamplerSettings(steps=1), draw_noise((1, 1, 2, 4, 4, 6), (0,)).double()

    def run(references: Tensor, of: list[Conditions]) -> Tensor:
        return sample_frame(network, references, join_conditions(network.config, of), noise, settings)

    base = run(seeds(), frames)
    for place in range(T):
        other = seeds()
        other[:, place] += 1.0
        assert not torch.allclose(run(other, frames), base)
    for place in range(T + 1):
        layout = frames[place].layout
        assert layout is not None
        changed = [*frames]
        changed[place] = replace(frames[place], layout=layout + 1.0)
        assert not torch.allclose(run(seeds(), changed), base)


def test_a_bidirectional_network_rolls_out_without_a_cache() -> None:
    network, frames = make_network(replace(AS_FRAMES, causal=False)), single_frames(T + 2)
    rollout = SequenceRollout(network, seeds(), frames[:T], SamplerSettings(steps=2))
    assert all(bool(rollout.step(conditions).isfinite().all()) for conditions in frames[T:])


def test_poses_of_a_window_are_relative_to_its_first_frame() -> None:
    frames = single_frames(4)
    joined = join_conditions(AS_FRAMES, frames)
    torch.testing.assert_close(joined.ego_to_first[0, 0], torch.eye(4, dtype=torch.float64))
    expected = torch.linalg.inv(frames[0].ego_to_first) @ frames[3].ego_to_first
    torch.testing.assert_close(joined.ego_to_first[:, 3:], expected)
    # The same motion of all frames changes nothing.
    moved = [replace(one, ego_to_first=frames[2].ego_to_first @ one.ego_to_first) for one in frames]
    torch.testing.assert_close(join_conditions(AS_FRAMES, moved).ego_to_first, joined.ego_to_first)


@pytest.mark.parametrize("name", CONFIGS)
def test_context_noise_changes_the_frame_and_is_told_to_the_network(name: str) -> None:
    network, frames = make_network(CONFIGS[name]), single_frames(T + 1)
    window = join_conditions(network.config, frames)
    noise, context = draw_noise((1, 1, 2, 4, 4, 6), (0,)).double(), draw_noise((1, T, 2, 4, 4, 6), (1,))
    settings = SamplerSettings(steps=1)
    plain = sample_frame(network, seeds(), window, noise, settings)
    noisy = sample_frame(network, seeds(), window, noise, replace(settings, context_noise=0.3), context_noise=context)
    by_hand = sample_frame(network, 0.7 * seeds() + 0.3 * context, window, noise, settings)
    assert not torch.allclose(noisy, plain)
    assert not torch.allclose(noisy, by_hand), "the level has no effect"


def test_guidance_of_one_is_no_guidance() -> None:
    network, frames = make_network(AS_CHANNELS), single_frames(T + 1)
    window = join_conditions(network.config, frames)
    noise = draw_noise((1, 1, 2, 4, 4, 6), (0,)).double()
    without = replace(window, layout=torch.zeros_like(window.layout))
    plain = sample_frame(network, seeds(), window, noise, SamplerSettings(steps=2))
    empty = sample_frame(network, seeds(), without, noise, SamplerSettings(steps=2))
    for scale, expected in ((1.0, plain), (0.0, empty)):
        settings = SamplerSettings(steps=2, guidance=scale)
        guided = sample_frame(network, seeds(), window, noise, settings, unconditional=without)
        torch.testing.assert_close(guided, expected, rtol=1e-9, atol=1e-9)
    with pytest.raises(UsageError, match="guidance 2"):
        sample_frame(network, seeds(), window, noise, SamplerSettings(guidance=2.0))


@pytest.mark.parametrize("name", CONFIGS)
def test_a_guided_rollout_is_pushed_away_from_frames_without_layout(name: str) -> None:
    """With one step the frame is linear in the velocity: at scale s it is empty + s * (plain - empty)."""
    network, frames = make_network(CONFIGS[name]), single_frames(T + 1)
    plain, empty, guided = (
        SequenceRollout(network, seeds(), frames[:T], SamplerSettings(steps=1, guidance=scale)).step(frames[T])
        for scale in (1.0, 0.0, 2.5)
    )
    bare = [replace(one, layout=torch.zeros_like(one.layout)) for one in frames if one.layout is not None]
    by_hand = SequenceRollout(network, seeds(), bare[:T], SamplerSettings(steps=1)).step(bare[T])
    torch.testing.assert_close(empty, by_hand, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(guided, empty + 2.5 * (plain - empty), rtol=1e-9, atol=1e-9)
    assert not torch.allclose(plain, empty)


@pytest.mark.parametrize("name", CONFIGS)
def test_guidance_adapts_each_background_once_and_the_empty_layout_once(name: str) -> None:
    network, frames = make_network(CONFIGS[name]), single_frames(T + 3)
    settings = SamplerSettings(steps=2, guidance=2.5)
    adapted: dict[str, int] = {"background_adapter": 0, "condition_image_adapter": 0}
    for adapter in adapted:

        def count(_: object, given: tuple[Tensor], __: object, adapter: str = adapter) -> None:
            adapted[adapter] += len(given[0]) // 2

        getattr(network, adapter).register_forward_hook(count)
    rollout = SequenceRollout(network, seeds(), frames[:T], settings)
    generated = [rollout.step(conditions) for conditions in frames[T:]]
    # As channels, the layouts of a window are one image, and another one without boxes.
    wanted = (3, 2 * 3) if name == "channels" else (T + 3, T + 3 + 1)
    assert tuple(adapted.values()) == wanted
    history = torch.cat([seeds(), *generated], dim=1)
    for place, latents in enumerate(generated):
        # Each pass on its own, by the definition of guidance.
        window = join_conditions(network.config, frames[place : place + T + 1])
        assert window.layout is not None
        passes = [
            target_velocity(network, history[:, place : place + T], network.prepare(one), cache=False)
            for one in (window, replace(window, layout=torch.zeros_like(window.layout)))
        ]
        expected = draw_noise(latents.shape, (0, place)).double()
        for level in (1.0, 0.5):
            with_boxes, without = (one(expected, level) for one in passes)
            expected = expected - 0.5 * (without + 2.5 * (with_boxes - without))
        torch.testing.assert_close(latents, expected, rtol=1e-9, atol=1e-9)


def test_guidance_needs_a_layout_and_a_finite_scale() -> None:
    network = make_network(replace(AS_FRAMES, layout=None))
    frames = [replace(one, layout=None) for one in single_frames(T + 1)]
    with pytest.raises(UsageError, match="guidance of a network without layout"):
        SequenceRollout(network, seeds(), frames[:T], SamplerSettings(guidance=2.0)).step(frames[T])
    for scale in (float("nan"), float("inf"), -1.0):
        with pytest.raises(UsageError, match="guidance"):
            SamplerSettings(guidance=scale)


@pytest.mark.parametrize("name", CONFIGS)
def test_half_precision_changes_a_frame_little(name: str) -> None:
    # Parameters as training begins with them: random ones of size 0.3 magnify every rounding.
    torch.manual_seed(0)
    network = Transformer(CONFIGS[name]).eval().requires_grad_(False)
    frames = [one.to(torch.float32) for one in single_frames(T + 1)]
    full, half = (
        SequenceRollout(network, seeds().float(), frames[:T], SamplerSettings(steps=2, precision=precision)).step(
            frames[T]
        )
        for precision in ("float32", "bf16")
    )
    assert half.dtype == torch.float32
    # bfloat16 has eight bits.
    assert 1e-5 < float((half - full).norm() / full.norm()) < 0.02


def test_rays_keep_their_precision_in_half_precision() -> None:
    network = make_network(AS_FRAMES).float()
    window = join_conditions(AS_FRAMES, single_frames(2)).to(torch.float32)
    far = window.ego_to_first.clone()
    far[:, 1, 0, 3] = 100.3
    window = replace(window, ego_to_first=far)
    whole = network.prepare(window).camera
    with torch.autocast("cpu", torch.bfloat16):
        half = network.prepare(window).camera
    assert whole is not None and half is not None
    assert float((half - whole).abs().max() / whole.abs().max()) < 0.02


def test_seeds_are_the_frames_before_the_window() -> None:
    assert list(seed_frames(5)) == [0, 1, 2, 3, 4]
    assert list(seed_frames(30)) == [25, 26, 27, 28, 29]
    with pytest.raises(UsageError, match="frame 4 has 4 frames before it"):
        seed_frames(4)


def test_conditions_that_do_not_fit_are_refused() -> None:
    network, frames = make_network(AS_FRAMES), single_frames(T + 1)
    with pytest.raises(UsageError, match="3 seeds with conditions of 2 frames"):
        SequenceRollout(network, seeds(), frames[:2], SamplerSettings())
    rollout = SequenceRollout(network, seeds(), frames[:T], SamplerSettings())
    with pytest.raises(UsageError, match="camera_to_ego"):
        rollout.step(replace(frames[T], camera_to_ego=frames[T].camera_to_ego * torch.nan))
    with pytest.raises(UsageError, match="as the seeds"):
        rollout.step(make_conditions(AS_FRAMES, frames=1, views=3))
    with pytest.raises(UsageError, match="context_noise"):
        SamplerSettings(context_noise=1.0)
    with pytest.raises(UsageError, match="0 steps"):
        SamplerSettings(steps=0)


def test_some_frames_without_background_are_refused() -> None:
    frames = single_frames(2)
    with pytest.raises(UsageError, match="no background"):
        join_conditions(AS_FRAMES, [replace(frames[0], background=None), frames[1]])


def test_frames_without_a_generated_view_cost_no_adapter() -> None:
    """Features are computed when a window needs them: of the frames that it shows, each once."""
    network, frames = make_network(AS_FRAMES), single_frames(T + 6)
    encoded: list[int] = []
    encode = network.encode_layout
    network.encode_layout = lambda conditions: encoded.append(id(conditions)) or encode(conditions)  # type: ignore[method-assign, assignment, func-returns-value]
    rollout = SequenceRollout(network, seeds(), frames[:T], SamplerSettings(steps=2))
    kept = torch.zeros((1, 1, 2, 4, 4, 6), dtype=torch.float64)
    for conditions in frames[T : T + 4]:
        rollout.step(conditions, active=[], kept=kept)
    assert encoded == []
    rollout.step(frames[T + 4])
    assert encoded == [id(one) for one in frames[4 : T + 5]]
    rollout.step(frames[T + 5])
    assert encoded[T + 1 :] == [id(frames[T + 5])]


def test_numbers_that_are_not_finite_do_not_become_black_frames() -> None:
    network = make_network(AS_CHANNELS)
    with torch.no_grad():
        network.proj_out.bias[0] = torch.nan
    frames = single_frames(T + 1)
    rollout = SequenceRollout(network, seeds(), frames[:T], SamplerSettings(steps=1), first=17)
    with pytest.raises(DatasetError, match="not finite") as caught:
        rollout.step(frames[T])
    assert caught.value.place == "frame 17"
