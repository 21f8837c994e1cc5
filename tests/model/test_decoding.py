"""Nodes decoded by compiled kernels, compared with plain torch in float64, with gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmarks.street.reference_model import plain_anchors, plain_gaussians
from hybridworldsim.model.nodes.fused_networks import run_fused
from hybridworldsim.model.nodes.network_inputs import network_inputs
from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import to_viewpoint
from tests.model.streets import SOURCES, street, view

PLACES = (view(-25.0), view(3.0, 5.0), view(200.0))


def numbers(splats):
    return splats.means, splats.quats, splats.scales, splats.opacities, splats.colours


def same_with_gradients(found, expected, node, exact):
    """Compare values and the gradients of a weighted sum with those of the node in float64."""
    generator = torch.Generator().manual_seed(5)
    weights = [torch.randn(one.shape, generator=generator) for one in found]
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one.double(), other, rtol=1e-5, atol=2e-5)
    sum((weight * one).sum() for weight, one in zip(weights, found)).backward()
    sum((weight.double() * one).sum() for weight, one in zip(weights, expected)).backward()
    for (name, one), (_, other) in zip(node.named_parameters(), exact.named_parameters(), strict=True):
        if other.grad is None:
            assert not one.requires_grad, name
            continue
        scale = float(other.grad.abs().max())
        torch.testing.assert_close(one.grad.double(), other.grad, rtol=0.0, atol=1e-5 * scale + 1e-6, msg=name)


def modulated(seed: int, k: int, hidden: int):
    """A street with no parameter at zero."""
    one = street(seed=seed, k=k, hidden=hidden)
    for network in (one.background.geometry, one.background.colour):
        torch.nn.init.normal_(network.own[:, -3:])
    for network in (one.background.colour, one.ground.colour, one.sky.colour):
        torch.nn.init.normal_(network.bend)
    return one


@pytest.mark.parametrize(("hidden", "k"), [(64, 10), (12, 10), (20, 3), (16, 1)])
@pytest.mark.parametrize("place", PLACES)
def test_decoding_matches_plain_torch(hidden, k, place):
    torch.manual_seed(hidden)
    one, exact = modulated(hidden, k, hidden), modulated(hidden, k, hidden)
    exact.load_state_dict(one.state_dict())
    exact.double()
    viewpoint = to_viewpoint(place, np.zeros(3))
    eye = viewpoint.centre.double()
    latent, content = (one.appearance(source).detach() for source in SOURCES)
    latent, content = latent + 0.3, content - 0.3
    splats = one.background.decode(viewpoint, latent, content)
    same_with_gradients(
        numbers(splats),
        plain_anchors(exact.background, splats.anchor_ids, eye, latent.double(), content.double()),
        one.background,
        exact.background,
    )
    for name in ("ground", "sky"):
        node, other = getattr(one, name), getattr(exact, name)
        splats = node.decode(viewpoint, latent)
        same_with_gradients(numbers(splats), plain_gaussians(other, splats.rows, eye, latent.double()), node, other)


@pytest.mark.parametrize(("hidden", "k"), [(64, 3), (12, 10), (33, 1)])
def test_decoding_without_gradients_matches_plain_torch(hidden, k):
    """The fused kernel; hidden layers and outputs that fill no vector are padded."""
    torch.manual_seed(hidden)
    one, exact = modulated(hidden, k, hidden), modulated(hidden, k, hidden)
    exact.load_state_dict(one.state_dict())
    exact.double()
    viewpoint = to_viewpoint(view(-25.0), np.zeros(3))
    eye, (latent, content) = viewpoint.centre.double(), (one.appearance(source).detach() for source in SOURCES)
    with torch.no_grad():
        splats = one.background.decode(viewpoint, latent, content)
        expected = plain_anchors(exact.background, splats.anchor_ids, eye, latent.double(), content.double())
        for found, other in zip(numbers(splats), expected, strict=True):
            torch.testing.assert_close(found.double(), other, rtol=1e-5, atol=2e-5)
        for node, other in ((one.ground, exact.ground), (one.sky, exact.sky)):
            splats = node.decode(viewpoint, latent)
            expected = plain_gaussians(other, splats.rows, eye, latent.double())
            torch.testing.assert_close(splats.colours.double(), expected[4], rtol=1e-5, atol=2e-5)


def test_a_fused_row_does_not_depend_on_the_others():
    one, generator = modulated(4, 3, 24), torch.Generator().manual_seed(1)
    network, latent = (one.background.colour, one.appearance(SOURCES[0]).detach())
    codes = torch.randn(1100, network.code, generator=generator)
    means, eye = 30.0 * torch.randn(1100, 3, generator=generator), torch.zeros(3)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        (together,) = run_fused(codes, means, eye, 40.0, (network, latent))
    finally:
        torch.set_num_threads(threads)
    for begin, end in ((0, 1), (1, 7), (6, 11), (500, 1100)):
        (apart,) = run_fused(codes[begin:end], means[begin:end], eye, 40.0, (network, latent))
        assert torch.equal(apart, together[begin:end])
    assert run_fused(codes[:0], means[:0], eye, 40.0, (network, latent))[0].shape == (0, 9)


def test_a_fused_row_that_is_not_finite_stays_so():
    one = modulated(4, 3, 24)
    network, latent = (one.background.geometry, one.appearance(SOURCES[0]).detach())
    codes, means = torch.zeros(4, network.code), torch.ones(4, 3)
    codes[1, 0], codes[2, 3], means[3, 1] = torch.nan, torch.inf, torch.nan
    (found,) = run_fused(codes, means, torch.zeros(3), 40.0, (network, latent))
    assert torch.isfinite(found).all(dim=1).tolist() == [True, False, False, False]


def test_appearances_get_gradients():
    one, exact = modulated(1, 4, 16), modulated(1, 4, 16)
    exact.load_state_dict(one.state_dict())
    exact.double()
    viewpoint = to_viewpoint(view(-25.0), np.zeros(3))
    splats = one.ground.decode(viewpoint, one.appearance(SOURCES[0]))
    splats.colours.sum().backward()
    plain_gaussians(exact.ground, splats.rows, viewpoint.centre.double(), exact.appearance(SOURCES[0]))[
        4
    ].sum().backward()
    torch.testing.assert_close(one.appearance.drives.grad.double(), exact.appearance.drives.grad, rtol=1e-4, atol=1e-4)


def test_an_empty_street_renders_an_empty_image():
    one = street(anchors=0)
    for node in (one.ground, one.sky):
        for name, table in list(node.named_parameters(recurse=False)):
            setattr(node, name, torch.nn.Parameter(table.detach()[:0]))
    output = one(to_viewpoint(view(), np.zeros(3)), one.appearance(SOURCES[0]))
    assert not output.alpha.any() and not output.rgb.any()


def test_gaussians_that_are_not_finite_are_dropped():
    one = street()
    one.background.codes.data[3] = torch.nan
    one.ground.means.data[5] = torch.inf
    output = one(to_viewpoint(view(-25.0), np.zeros(3)), one.appearance(SOURCES[0]))
    assert torch.isfinite(output.rgb).all()


def test_a_camera_at_a_point_gives_a_zero_direction():
    codes, means = torch.ones(2, 5, requires_grad=True), torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    found = network_inputs(codes, means, means[0], 2.0)
    assert found.shape == (2, 12)
    assert found[0].tolist() == [1.0] * 5 + [0.0, 0.0, 0.0] + [0.5, 1.0, 1.5] + [1.0]
    found.sum().backward()
    assert codes.grad.tolist() == [[1.0] * 5] * 2


def test_gathered_rows_are_used_unchanged():
    one = modulated(2, 4, 16)
    viewpoint, latent = to_viewpoint(view(-25.0), np.zeros(3)), one.appearance(SOURCES[0]).detach()
    ids = one.ground.visible_ids(viewpoint)
    leaf = one.ground.codes.detach()[ids].requires_grad_()
    given = one.ground.decode(viewpoint, latent, one.ground.rows(ids, {"codes": leaf}))
    looked_up = one.ground.decode(viewpoint, latent)
    assert all(torch.equal(a, b) for a, b in zip(numbers(given), numbers(looked_up)))
    given.colours.sum().backward()
    looked_up.colours.sum().backward()
    torch.testing.assert_close(leaf.grad, one.ground.codes.grad[ids])


def test_results_do_not_depend_on_the_number_of_threads():
    one, threads = modulated(0, 10, 64), torch.get_num_threads()
    found = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            found.append(network_inputs(one.ground.codes, one.ground.means, torch.zeros(3)))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*found)


def test_visible_rows_are_spheres_that_meet_the_frustum():
    generator = torch.Generator().manual_seed(0)
    means = 100.0 * (torch.rand(5000, 3, generator=generator) - 0.5)
    reach = torch.rand(5000, generator=generator)
    for place in (view(), view(-60.0, fx_px=400.0), view(3.0, 3.0, 30.0, fx_px=10.0)):
        viewpoint = to_viewpoint(place, np.zeros(3))
        x, y, z = (means.double() @ viewpoint.viewmat[:3, :3].double().T + viewpoint.viewmat[:3, 3].double()).unbind(1)
        is_visible = z + reach > 0.05
        for along, axis, size in ((x, 0, viewpoint.width_px), (y, 1, viewpoint.height_px)):
            focal, middle = viewpoint.K[axis, axis].item(), viewpoint.K[axis, 2].item()
            for slope, side in ((middle / focal, along), ((size - middle) / focal, -along)):
                # The signed distance to the side's plane, whose normal points inwards.
                is_visible &= (side + slope * z) / (1.0 + slope * slope) ** 0.5 > -reach
        ours = select_visible(viewpoint, means, reach)
        assert 0 < len(ours) < 5000 and ours.diff().gt(0).all()
        assert len(np.setxor1d(ours.numpy(), is_visible.nonzero().squeeze(1).numpy())) <= 1
