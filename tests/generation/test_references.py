"""References whose keys and values are computed once, and the operations that a frame takes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import BACKGROUND, CTSD_35
from hybridworldsim.generation.network.transformer import Transformer
from mirror.errors import UsageError
from tests.generation.builders import SHORT, make_conditions, make_latents, make_network


@pytest.mark.parametrize("attention", ["pointwise", "full"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("missing", [False, True])
def test_cached_references_give_the_same_velocity(attention: str, dtype: torch.dtype, missing: bool) -> None:
    network = make_network(replace(SHORT, temporal_attention=attention)).to(dtype)
    conditions = make_conditions(SHORT, frames=6, views=2)
    if missing:
        present = torch.ones((1, 6, 2), dtype=torch.bool)
        present[0, 2, 1] = False
        conditions = replace(conditions, present=present)
    latents, timestep = make_latents(SHORT, conditions)
    latents, prepared = latents.to(dtype), network.prepare(conditions.to(dtype))
    timestep[:, :5] = 0.0
    cache = network.encode_references(latents[:, :5], timestep[:, :5], prepared.frames(slice(0, 5)))
    for level in (1000.0, 400.0):
        timestep[:, 5] = level
        whole = network(latents, timestep, prepared)[:, 5:]
        target = network(latents[:, 5:], timestep[:, 5:], prepared.frames(slice(5, 6)), cache)
        torch.testing.assert_close(target, whole, rtol=1e-5, atol=1e-5 if dtype == torch.float32 else 1e-10)


def test_a_network_that_is_not_causal_has_no_cache() -> None:
    network = make_network(replace(SHORT, causal=False))
    conditions = make_conditions(SHORT, frames=2, views=1)
    latents, timestep = make_latents(SHORT, conditions)
    with pytest.raises(UsageError, match="not causal"):
        network.encode_references(latents, timestep, network.prepare(conditions))


def test_features_of_frames_may_be_computed_one_by_one() -> None:
    network = make_network(SHORT)
    conditions = make_conditions(SHORT, frames=3, views=2)
    whole = network.encode_images(conditions)
    for frame in range(3):
        part = slice(frame, frame + 1)
        one = replace(
            conditions,
            intrinsics=conditions.intrinsics[:, part],
            layout=conditions.layout[:, part],
            background=conditions.background[:, part],
        )
        for feature, of_frame in zip(whole, network.encode_images(one), strict=True):
            torch.testing.assert_close(feature.unflatten(0, (3, 2))[frame], of_frame, rtol=1e-9, atol=1e-9)


def on_meta(frames: int, views: int, config=CTSD_35) -> tuple[Conditions, torch.Tensor, torch.Tensor]:
    """Conditions, latents and time steps of 256 x 448 pixels without numbers."""
    shape, size = (1, frames, views), (256, 448)
    conditions = Conditions(
        size,
        torch.zeros(*shape, 3, 3),
        torch.zeros(*shape, 4, 4),
        torch.zeros(1, frames, 4, 4),
        torch.zeros(1),
        torch.zeros(*shape, 154, 4096),
        torch.zeros(*shape, 2048),
        torch.zeros(*shape, 6, *size),
        None if config.background is None else torch.zeros(*shape, 3, *size),
    )
    return conditions, torch.zeros(*shape, 16, 32, 56), torch.zeros(shape)


@pytest.fixture(scope="module")
def released() -> Transformer:
    """The released model, made causal, with a background adapter; without numbers."""
    with torch.device("meta"):
        return Transformer(replace(CTSD_35, causal=True, background=BACKGROUND))


def test_a_frame_of_seven_views_takes_at_most_132_tera_operations(released: Transformer) -> None:
    with torch.device("meta"):
        references, five, steps_of_five = on_meta(5, 7, released.config)
        target, one, step_of_one = on_meta(1, 7, released.config)
        # The adapters' features of the references were computed when these frames were generated.
        features = [torch.zeros(35, 448, 1536)] * 6
        with FlopCounterMode(display=False) as counter:
            cache = released.encode_references(five, steps_of_five, released.prepare(references, features))
            prepared = released.prepare(target)
        with FlopCounterMode(display=False) as step:
            released(one, step_of_one, prepared, cache)
    operations = counter.get_total_flops() + 4 * step.get_total_flops()
    # 130.86e12: of these 71.2e12 for the references, 1.9e12 for the adapters, 14.4e12 for each step.
    assert 130e12 <= operations <= 132e12


def test_ten_naive_steps_take_979_tera_operations(released: Transformer) -> None:
    with torch.device("meta"):
        conditions, latents, timestep = on_meta(6, 7)
        with FlopCounterMode(display=False) as counter:
            released(latents, timestep, released.prepare(conditions))
    assert 10 * counter.get_total_flops() == pytest.approx(979e12, rel=0.005)
