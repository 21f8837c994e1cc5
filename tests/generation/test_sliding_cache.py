"""The sliding cache: what it equals, how far it is from the exact references, and what it saves."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.inference.windows import join_conditions
from hybridworldsim.generation.network import transformer
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.sampler import draw_noise
from mirror.errors import UsageError
from tests.generation.builders import make_network
from tests.generation.rollout_inputs import AS_CHANNELS, AS_FRAMES, T, seeds, single_frames

EXACT = SamplerSettings(steps=1)
SLIDING = replace(EXACT, refresh_every=4)
COUNT = 6


def roll(
    settings: SamplerSettings, network: Transformer, frames: list[Conditions], **given
) -> tuple[SequenceRollout, Tensor]:
    rollout = SequenceRollout(network, seeds(), frames[:T], settings, **given)
    return rollout, torch.cat([rollout.step(one) for one in frames[T:]], dim=1)


def band_mask(band: int):
    """A mask of one long causal sequence, in place of the transformer's: each frame attends to the last ones only.

    The last frame is the target, which attends to one frame more than the references do.
    """

    def mask(*_: object, shape: tuple[int, int, int], tokens: int, pointwise: bool, **__: object) -> Tensor:
        place = torch.arange(shape[1])
        back = place[:, None] - place
        allowed = (back >= 0) & (back < band + (place[:, None] == shape[1] - 1))
        allowed = allowed[None, None]
        return allowed if pointwise else allowed.repeat_interleave(tokens, 2).repeat_interleave(tokens, 3)

    return mask


@pytest.mark.parametrize("attention", ["pointwise", "full"])
def test_it_is_one_long_causal_sequence_in_which_each_frame_attends_to_the_last_references(
    attention: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network, frames = make_network(replace(AS_FRAMES, temporal_attention=attention)), single_frames(T + 4)
    _, generated = roll(SLIDING, network, frames)
    monkeypatch.setattr(transformer, "temporal_mask", band_mask(T))
    history = torch.cat([seeds(), generated], dim=1)
    for place in range(4):
        # Without any cache: all frames from the first seed to the target, with poses relative to the first seed.
        length = T + place + 1
        conditions = network.prepare(join_conditions(network.config, frames[:length]))
        noise = draw_noise((1, 1, 2, 4, 4, 6), (0, place)).double()
        timestep = torch.zeros((1, length, 2), dtype=torch.float64)
        timestep[:, -1] = 1000.0
        velocity = network(torch.cat([history[:, : length - 1], noise], dim=1), timestep, conditions)[:, -1:]
        torch.testing.assert_close(generated[:, place : place + 1], noise - velocity, rtol=1e-9, atol=1e-9)


def test_the_first_frame_and_each_refreshed_one_are_exact_and_the_others_are_not() -> None:
    network, frames = make_network(AS_FRAMES), single_frames(T + COUNT)
    rollout, sliding = roll(SLIDING, network, frames)
    history = torch.cat([seeds(), sliding], dim=1)
    shares = []
    for place in range(COUNT):
        # The exact frame from the same references.
        alone = SequenceRollout(network, history[:, place : place + T], frames[place : place + T], EXACT, first=place)
        exact = alone.step(frames[place + T])
        shares.append(float((sliding[:, place : place + 1] - exact).norm() / exact.norm()))
    assert [share < 1e-9 for share in shares] == [True, False, False, False, True, False]
    # Measured 0.28, 0.37, 0.70 and 0.43: parameters are random, and poses have no relation to one another.
    assert max(shares) < 0.75
    assert rollout.sliding is not None
    # Exactly, 3 references for each of 6 frames; here for frames 0 and 4, and one for each other.
    assert rollout.sliding.encoded_frames == 2 * T + 4 < COUNT * T


def test_a_period_of_one_is_the_exact_rollout() -> None:
    network, frames = make_network(AS_FRAMES), single_frames(T + 3)
    assert SamplerSettings().refresh_every == 1
    rollout, exact = roll(EXACT, network, frames)
    assert rollout.sliding is None
    without_cache = roll(replace(EXACT, cache=False), network, frames)[1]
    torch.testing.assert_close(exact, without_cache, rtol=1e-9, atol=1e-9)


def test_other_views_or_a_frame_without_any_begin_with_exact_references() -> None:
    network, frames = make_network(AS_FRAMES), single_frames(T + 6)
    rollout = SequenceRollout(network, seeds(), frames[:T], replace(EXACT, refresh_every=9))
    assert rollout.sliding is not None
    kept = torch.zeros((1, 1, 2, 4, 4, 6), dtype=torch.float64)
    counts = []
    for place, active in enumerate([[0, 1], [0, 1], [1], [1], [], [1]]):
        rollout.step(frames[T + place], active=active, kept=kept)
        counts.append(rollout.sliding.encoded_frames)
    assert [after - before for before, after in zip([0, *counts], counts)] == [T, 1, T, 1, 0, T]


def test_missing_views_of_earlier_references_stay_missing() -> None:
    """A view that a reference does not have is not attended to later: what its latents hold does not matter."""
    network, frames = make_network(AS_FRAMES), single_frames(T + 3)
    frames[1] = replace(frames[1], present=torch.tensor([[[True, False]]]))
    results = []
    for value in (0.0, 5.0):
        latents = seeds()
        latents[:, 1, 1] = value
        rollout = SequenceRollout(network, latents, frames[:T], SLIDING)
        results.append(torch.cat([rollout.step(one) for one in frames[T:]], dim=1))
    torch.testing.assert_close(*results, rtol=1e-9, atol=1e-9)


def test_noise_on_references_goes_with_it() -> None:
    network, frames = make_network(AS_FRAMES), single_frames(T + 2)
    noisy = roll(replace(SLIDING, context_noise=0.3), network, frames)[1]
    exact = roll(replace(EXACT, context_noise=0.3), network, frames)[1]
    torch.testing.assert_close(noisy[:, :1], exact[:, :1], rtol=1e-9, atol=1e-9)
    assert bool(noisy.isfinite().all()) and not torch.allclose(noisy[:, 1], exact[:, 1])


@pytest.mark.parametrize("changes", [{"refresh_every": 0}, {"cache": False}, {"guidance": 2.0}])
def test_settings_that_do_not_go_with_it_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="refresh_every"):
        replace(SLIDING, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("config", [AS_CHANNELS, replace(AS_FRAMES, causal=False)], ids=["channels", "bidirectional"])
def test_networks_without_keys_to_keep_are_refused(config) -> None:
    with pytest.raises(UsageError, match="refresh_every 4 for this network"):
        SequenceRollout(make_network(config), seeds(), single_frames(T), SLIDING)
