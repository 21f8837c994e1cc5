"""The transformer against a plain reference, released names, and properties of its conditions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.generation.network.checkpoints import load_transformer
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import CTSD_35, UNIMLVG, AdapterConfig, TransformerConfig
from hybridworldsim.generation.network.embeddings import token_rays
from hybridworldsim.generation.network.joint_block import JointAttention, JointBlock
from hybridworldsim.generation.network.transformer import Transformer
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError
from tests.generation.builders import (
    SHORT,
    SMALL,
    SMALL_UNIMLVG,
    make_conditions,
    make_latents,
    make_network,
    released_checkpoint,
)
from tests.generation.ctsd35_keys import keys, unimlvg_keys
from tests.generation.reference import Reference


@cache
def shapes_of(config: TransformerConfig) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):
        return {name: tuple(tensor.shape) for name, tensor in Transformer(config).state_dict().items()}


def run(network: Transformer, conditions: Conditions, latents: torch.Tensor, timestep: torch.Tensor) -> torch.Tensor:
    return network(latents, timestep, network.prepare(conditions))


def run_reference(
    state: dict[str, torch.Tensor],
    config: TransformerConfig,
    conditions: Conditions,
    latents: torch.Tensor,
    timestep: torch.Tensor,
) -> np.ndarray:
    reference = Reference(
        {name: tensor.double().numpy() for name, tensor in state.items()}, config.heads, causal=config.causal
    )
    _, frames, views = conditions.shape
    rows, columns = (side // config.token_px for side in conditions.size_px)
    lens, to_ego = conditions.intrinsics[0].numpy(), conditions.camera_to_ego[0].numpy()
    if config.camera == "implicit":
        rate = float(conditions.rate_hz[0])
        cameras = [
            [reference.camera(rate, lens[t, v], to_ego[t, v], columns / rows) for v in range(views)]
            for t in range(frames)
        ]
    else:
        to_first = conditions.ego_to_first[0].numpy()
        cameras = [
            [reference.rays(lens[t, v], to_first[t] @ to_ego[t, v], rows, columns) for v in range(views)]
            for t in range(frames)
        ]
    present = np.ones((frames, views), bool) if conditions.present is None else conditions.present[0].numpy()
    adjacent = np.ones((views, views), bool) if conditions.adjacent is None else conditions.adjacent[0].numpy()
    layout = None if conditions.layout is None else conditions.layout[0].numpy()
    return reference.run(
        latents[0].numpy(),
        timestep[0].numpy(),
        conditions.text[0].numpy(),
        conditions.pooled[0].numpy(),
        cameras,
        layout,
        present,
        adjacent,
    )


def test_names_and_shapes_are_the_released_ones() -> None:
    assert len(keys()) == 1443
    assert shapes_of(CTSD_35) == keys()


def test_unimlvg_has_the_released_names_and_the_published_number_of_parameters() -> None:
    shapes = unimlvg_keys()
    assert len(shapes) == 1034
    assert shapes["rayencoder.proj.weight"] == (1536, 72)
    assert shapes["pos_embed.pos_embed"] == (1, 192 * 192, 1536)
    assert shapes_of(UNIMLVG) == shapes
    parameters = sum(np.prod(shape) for name, shape in shapes.items() if name != "pos_embed.pos_embed")
    assert round(parameters / 1e6) == 3346


def test_loaded_checkpoint_gives_the_output_of_the_plain_reference(tmp_path: Path) -> None:
    path = tmp_path / "ctsd.pth"
    released_checkpoint(path)
    network = load_transformer(path, SMALL)
    conditions = make_conditions(SMALL, frames=2, views=2, rows=1, columns=2)
    conditions = replace(conditions, present=torch.tensor([[[True, True], [True, False]]]))
    latents, timestep = make_latents(SMALL, conditions)
    with torch.no_grad():
        ours = run(network, conditions, latents, timestep)[0].numpy()
    reference = run_reference(torch.load(path, weights_only=True), SMALL, conditions, latents, timestep)
    assert np.abs(reference).max() > 0.1
    np.testing.assert_allclose(ours, reference, rtol=1e-9, atol=1e-9)


def test_unimlvg_is_loaded_strictly_by_key(tmp_path: Path) -> None:
    state = released_checkpoint(tmp_path / "unimlvg.pth", "unimlvg", torch.float32)
    loaded = load_transformer(tmp_path / "unimlvg.pth", SMALL_UNIMLVG).state_dict()
    assert loaded.keys() == state.keys()
    assert all(torch.equal(loaded[name], tensor) for name, tensor in state.items())
    # A norm of queries, as the model on Stable Diffusion 3.5 has it, in place of the rays.
    del state["rayencoder.proj.weight"]
    state["transformer_blocks.0.attn.norm_q.weight"] = torch.ones(4)
    torch.save(state, tmp_path / "other.pth")
    missing, extra = r"rayencoder\.proj\.weight", r"transformer_blocks\.0\.attn\.norm_q\.weight"
    message = rf"1 tensors are missing \({missing}\) and 1 are unknown \({extra}\)"
    with pytest.raises(WeightsUnavailableError, match=message):
        load_transformer(tmp_path / "other.pth", SMALL_UNIMLVG)


def test_loaded_unimlvg_attends_among_all_tokens_of_all_frames_in_both_directions(tmp_path: Path) -> None:
    released_checkpoint(tmp_path / "unimlvg.pth", "unimlvg")
    network = load_transformer(tmp_path / "unimlvg.pth", SMALL_UNIMLVG, dtype=torch.float64)
    conditions = make_conditions(SMALL_UNIMLVG, frames=2, views=1, rows=1, columns=2)
    latents, timestep = make_latents(SMALL_UNIMLVG, conditions)
    with torch.no_grad():
        base = run(network, conditions, latents, timestep)
        for frame, token in ((0, 0), (1, 1)):
            other = latents.clone()
            other[:, frame, :, :, :, 2 * token : 2 * token + 2] += 1.0
            changed = (run(network, conditions, other, timestep) - base).abs().amax(dim=(0, 2, 3, 4))
            assert float(changed.min()) > 1e-6


def test_explicit_cameras_and_adjacent_views_agree_with_the_plain_reference() -> None:
    config = replace(SMALL, camera="explicit", causal=True, layout=None)
    network = make_network(config)
    conditions = make_conditions(config, frames=2, views=3, rows=1, columns=2)
    conditions = replace(conditions, adjacent=torch.tensor([[[1, 1, 0], [1, 1, 1], [0, 1, 1]]]).bool())
    latents, timestep = make_latents(config, conditions)
    ours = run(network, conditions, latents, timestep)[0].numpy()
    reference = run_reference(network.state_dict(), config, conditions, latents, timestep)
    np.testing.assert_allclose(ours, reference, rtol=1e-9, atol=1e-9)


def test_new_background_adapter_does_not_change_the_output(tmp_path: Path) -> None:
    path = tmp_path / "ctsd.pth"
    released_checkpoint(path)
    with_background = replace(SMALL, background=AdapterConfig(3, 4, scales=(1, 2)))
    conditions = make_conditions(with_background, frames=2, views=2)
    latents, timestep = make_latents(SMALL, conditions)
    with torch.no_grad():
        adapted = run(load_transformer(path, with_background), conditions, latents, timestep)
        base = run(load_transformer(path, SMALL), replace(conditions, background=None), latents, timestep)
    assert torch.equal(adapted, base)


def test_saved_background_adapter_is_loaded(tmp_path: Path) -> None:
    network = make_network(SHORT)
    torch.save(network.state_dict(), tmp_path / "own.pth")
    loaded = load_transformer(tmp_path / "own.pth", SHORT)
    conditions = make_conditions(SHORT, frames=1, views=1)
    latents, timestep = make_latents(SHORT, conditions)
    with torch.no_grad():
        assert torch.equal(run(loaded, conditions, latents, timestep), run(network, conditions, latents, timestep))
        without = run(network, replace(conditions, background=None), latents, timestep)
    assert not torch.allclose(without, run(network, conditions, latents, timestep))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.pop("proj_out.bias"), r"1 tensors are missing \(proj_out.bias\)"),
        (lambda state: state.update(extra=torch.zeros(1)), r"1 are unknown \(extra\)"),
        (lambda state: state.update({"proj_out.bias": torch.zeros(63)}), r"proj_out.bias has shape \(63,\)"),
        (lambda state: state["proj_out.bias"].fill_(float("nan")), "proj_out.bias holds numbers that are not finite"),
    ],
)
def test_other_checkpoints_are_refused(tmp_path: Path, change: object, message: str) -> None:
    state = make_network(SHORT).state_dict()
    change(state)  # type: ignore[operator]
    torch.save(state, tmp_path / "own.pth")
    with pytest.raises(WeightsUnavailableError, match=message):
        load_transformer(tmp_path / "own.pth", SHORT)


def test_checkpoint_of_another_generation_is_named(tmp_path: Path) -> None:
    torch.save({name: torch.zeros(1) for name in shapes_of(UNIMLVG)}, tmp_path / "other.pth")
    with pytest.raises(WeightsUnavailableError, match="load it as unimlvg"):
        load_transformer(tmp_path / "other.pth", CTSD_35)


@pytest.mark.parametrize("views", [1, 6, 7])
def test_any_number_of_views(views: int) -> None:
    network = make_network(SHORT)
    conditions = make_conditions(SHORT, frames=2, views=views)
    latents, timestep = make_latents(SHORT, conditions)
    out = run(network, conditions, latents, timestep)
    assert out.shape == latents.shape
    assert bool(out.isfinite().all())


@pytest.mark.parametrize("attention", ["pointwise", "full"])
def test_missing_views_count_as_if_they_were_not_in_the_rig(attention: str) -> None:
    network = make_network(replace(SHORT, temporal_attention=attention))
    conditions = make_conditions(SHORT, frames=2, views=3)
    latents, timestep = make_latents(SHORT, conditions)
    present = torch.tensor([[[True, False, True]] * 2])
    masked = run(network, replace(conditions, present=present), latents, timestep)
    kept = [0, 2]
    fields = {
        name: getattr(conditions, name)[:, :, kept]
        for name in ("intrinsics", "camera_to_ego", "text", "pooled", "layout", "background")
    }
    two = replace(conditions, **fields, view_index=torch.tensor(kept))
    removed = run(network, two, latents[:, :, kept], timestep[:, :, kept])
    torch.testing.assert_close(masked[:, :, kept], removed, rtol=1e-9, atol=1e-9)


def test_all_views_of_a_sequence_may_be_missing() -> None:
    network = make_network(SHORT)
    conditions = make_conditions(SHORT, frames=2, views=2)
    latents, timestep = make_latents(SHORT, conditions)
    out = run(network, replace(conditions, present=torch.zeros((1, 2, 2), dtype=torch.bool)), latents, timestep)
    assert bool(out.isfinite().all())


def test_sequences_of_a_batch_are_independent() -> None:
    network = make_network(SHORT)
    conditions = make_conditions(SHORT, frames=2, views=2, batch=2)
    latents, timestep = make_latents(SHORT, conditions)
    both = run(network, conditions, latents, timestep)
    names = ("intrinsics", "camera_to_ego", "ego_to_first", "rate_hz", "text", "pooled", "layout", "background")
    second = replace(conditions, **{name: getattr(conditions, name)[1:] for name in names})
    torch.testing.assert_close(both[1:], run(network, second, latents[1:], timestep[1:]), rtol=1e-9, atol=1e-9)


def test_later_frames_do_not_change_earlier_ones_of_a_causal_network() -> None:
    network = make_network(SHORT)
    conditions = make_conditions(SHORT, frames=3, views=2)
    latents, timestep = make_latents(SHORT, conditions)
    other = latents.clone()
    other[:, 2] += 1.0
    before, after = run(network, conditions, latents, timestep), run(network, conditions, other, timestep)
    torch.testing.assert_close(before[:, :2], after[:, :2], rtol=1e-12, atol=1e-12)
    assert not torch.allclose(before[:, 2], after[:, 2])


def test_empty_text_is_allowed() -> None:
    config = replace(SMALL, layout=None)
    network = make_network(config)
    conditions = make_conditions(config, frames=1, views=1)
    latents, timestep = make_latents(config, conditions)
    without = replace(conditions, text=conditions.text[..., :0, :])
    out = run(network, without, latents, timestep)
    # The reference computes the text's half of each block, for no tokens.
    expected = run_reference(network.state_dict(), config, without, latents, timestep)
    np.testing.assert_allclose(out[0].detach().numpy(), expected, rtol=1e-9, atol=1e-9)


def test_no_text_needs_no_half_of_a_block() -> None:
    torch.manual_seed(0)
    attention = JointAttention(16, 2, norm=True)
    image = torch.randn(3, 5, 16)
    # Joined with no tokens of a text, or not joined at all.
    joined, _ = attention(image, torch.zeros(3, 0, 16))
    assert torch.equal(joined, attention(image)[0])
    block = JointBlock(16, 2, norm=True, dual=False, last=False)
    block(image, torch.zeros(3, 0, 16), torch.randn(3, 16))[0].sum().backward()
    assert block.attn.to_q.weight.grad is not None and block.attn.add_q_proj.weight.grad is None


def test_recomputed_layers_give_the_same_gradient() -> None:
    network = make_network(SHORT).requires_grad_(True)
    conditions = make_conditions(SHORT, frames=2, views=1)
    latents, timestep = make_latents(SHORT, conditions)
    gradients = []
    for network.recompute in (False, True):
        network.zero_grad()
        run(network, conditions, latents, timestep).square().sum().backward()
        gradients.append({name: parameter.grad for name, parameter in network.named_parameters()})
    for name, gradient in gradients[0].items():
        assert gradient is not None, name
        torch.testing.assert_close(gradient, gradients[1][name], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("latents", "message"),
    [
        ((1, 1, 1, 15, 4, 6), r"\(B, T, V, 16, height, width\)"),
        ((1, 1, 1, 16, 3, 6), "multiples of 2"),
        ((1, 2, 1, 16, 4, 6), "as the conditions"),
    ],
)
def test_latents_of_another_shape_are_refused(latents: tuple[int, ...], message: str) -> None:
    network = make_network(SHORT)
    prepared = network.prepare(make_conditions(SHORT, frames=1, views=1))
    with pytest.raises(UsageError, match=message):
        network(torch.zeros(latents, dtype=torch.float64), torch.zeros(latents[:3], dtype=torch.float64), prepared)


def test_rays_pass_through_the_centres_of_tokens() -> None:
    lens = torch.tensor([[[2.0, 0.0, 0.5], [0.0, 3.0, 0.25], [0.0, 0.0, 1.0]]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)[None]
    pose[0, :3, 3] = torch.tensor([1.0, 2.0, 3.0])
    origin, direction = token_rays(lens, pose, rows=2, columns=4)
    assert origin.tolist() == [[1.0, 2.0, 3.0]]
    # Second row, last column: (0.875, 0.75) of the image.
    expected = torch.tensor([(0.875 - 0.5) / 2.0, (0.75 - 0.25) / 3.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(direction[0, 7], expected / expected.norm())
