"""Which Gaussians a pixel shows, how deep, and which way they face."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.buffers import facing_axes, normals, trace
from mirror.errors import UsageError
from tests.rasterizer._scenes import HEIGHT, WIDTH, both_backends, cameras, merged, one, scene, with_gradients

MIDDLE = (HEIGHT * 9 // 16, WIDTH * 7 // 16)


def _paths(meta, camera):
    """Weights (pixels, M) in front-to-back order, their ids and depths: all pixels, all Gaussians, one by one."""
    rows = (meta["camera_ids"] == camera).nonzero()[:, 0].numpy()
    rows = rows[np.argsort(meta["depths"].detach().float().numpy()[rows], kind="stable")]
    means, conics, opacities = (
        meta[name].detach().double().numpy()[rows] for name in ("means2d", "conics", "opacities")
    )
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    dx, dy = x.reshape(-1, 1) - means[:, 0], y.reshape(-1, 1) - means[:, 1]
    form = conics[:, 0] * dx**2 + 2 * conics[:, 1] * dx * dy + conics[:, 2] * dy**2
    alpha = np.minimum(opacities * np.exp(-0.5 * form), 0.999)
    alpha[alpha < 1.0 / 255.0] = 0.0
    behind = np.cumprod(1.0 - alpha, axis=1)
    alpha[behind <= 1e-4] = 0.0
    behind = np.cumprod(1.0 - alpha, axis=1)
    before = np.concatenate([np.ones((len(alpha), 1)), behind[:, :-1]], axis=1)
    return alpha * before, behind, meta["gaussian_ids"].numpy()[rows], meta["depths"].detach().numpy()[rows]


@both_backends
def test_every_pixel_names_the_gaussians_that_it_shows(backend):
    _, _, meta = rasterization(**scene(count=120, views=2), backend=backend)
    found = trace(meta, top=4)
    assert found.ids.shape == found.weights.shape == (2, HEIGHT, WIDTH, 4)
    assert found.n_contrib.max() > 4
    for camera in range(2):
        weights, behind, ids, depths = _paths(meta, camera)
        order = np.argsort(-weights, axis=1, kind="stable")[:, :4]
        greatest = np.take_along_axis(weights, order, 1)
        expected_ids = np.where(greatest > 0.0, ids[order], -1)
        got = found.ids[camera].reshape(-1, 4).numpy()
        assert (got == expected_ids).mean() > 0.999
        np.testing.assert_allclose(found.weights[camera].reshape(-1, 4), greatest, atol=2e-5)
        number = (weights > 0.0).sum(1)
        assert (found.n_contrib[camera].reshape(-1).numpy() == number).mean() > 0.999
        crossed = behind <= 0.5
        median = np.where(crossed.any(1), depths[crossed.argmax(1)], 0.0)
        assert np.isclose(found.median_depth[camera].reshape(-1), median, rtol=1e-6).mean() > 0.999


@both_backends
def test_weights_of_all_gaussians_sum_to_alpha(backend):
    _, alpha, meta = rasterization(**scene(), backend=backend)
    found = trace(meta, top=int(trace(meta).n_contrib.max()))
    torch.testing.assert_close(found.weights.sum(-1), alpha[..., 0], rtol=0, atol=1e-5)
    assert torch.equal((found.ids >= 0).sum(-1), found.n_contrib.long())
    assert (found.weights.diff(dim=-1) <= 0.0).all()


@both_backends
def test_a_weak_gaussian_in_front_neither_names_a_pixel_nor_sets_its_depth(backend):
    front, back = one((0.0, 0.0, 2.0), 0.3, 0.25, (1.0,)), one((0.0, 0.0, 5.0), 1.5, 0.9, (1.0,))
    _, _, meta = rasterization(**merged(front, back) | cameras(), backend=backend, render_mode="D")
    found = trace(meta, top=3)
    assert found.ids[0, *MIDDLE].tolist() == [1, 0, -1]
    assert found.weights[0, *MIDDLE].tolist() == pytest.approx([0.75 * 0.9, 0.25, 0.0], abs=0.02)
    assert found.median_depth[0, *MIDDLE] == 5.0
    assert found.n_contrib[0, *MIDDLE] == 2
    _, _, meta = rasterization(**front | cameras(), backend=backend)
    assert (trace(meta).median_depth == 0.0).all()


@both_backends
def test_packed_or_not_and_leading_dimensions_make_no_difference(backend):
    arguments = scene(views=2)
    plain = trace(rasterization(**arguments, backend=backend)[2], top=2)
    whole = trace(rasterization(**arguments, backend=backend, packed=False)[2], top=2)
    names = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")
    batched = arguments | {name: arguments[name][None] for name in names}
    lifted = trace(rasterization(**batched, backend=backend)[2], top=2)
    for a, b, c in zip(plain, whole, lifted, strict=True):
        assert torch.equal(a, b)
        assert torch.equal(a[None], c)


@both_backends
def test_an_empty_picture_shows_nothing(backend):
    arguments = scene(count=5) | {"near_plane": 100.0}
    _, _, meta = rasterization(**arguments, backend=backend)
    found = trace(meta, top=2)
    assert (found.ids == -1).all()
    assert all((picture == 0).all() for picture in found[1:])
    trained = (arguments[name] for name in ("means", "quats", "scales", "viewmats"))
    assert (normals(meta, *trained) == 0.0).all()


def test_the_oldest_preset_is_cut_where_its_picture_is():
    arguments = one((0.05, 0.02, 3.0), 0.6, 0.99, (1.0,)) | cameras(1, 64, 48)
    _, alpha, meta = rasterization(**arguments, backend="reference", preset="gsplat-1.3", tile_size=4)
    found = trace(meta)
    torch.testing.assert_close(found.weights[..., 0], alpha[..., 0])
    assert (alpha[..., 0] == 0.0).any()


def test_buffers_are_asked_of_what_was_rendered_here():
    with pytest.raises(UsageError, match="CUDA"):
        trace({"means2d": torch.zeros(1, 2)})
    _, _, meta = rasterization(**scene(), backend="reference")
    with pytest.raises(UsageError, match="at least 1"):
        trace(meta, top=0)


def _disc(angle, count=1):
    """A flat Gaussian that faces -z, turned about y."""
    half = 0.5 * angle
    return {
        "means": torch.tensor([[0.0, 0.0, 3.0]]).repeat(count, 1),
        "quats": torch.tensor([[math.cos(half), 0.0, math.sin(half), 0.0]]).repeat(count, 1) * 2.0,
        "scales": torch.tensor([[1.0, 1.0, 0.01]]).repeat(count, 1),
        "opacities": torch.full((count,), 0.9),
        "colors": torch.ones(count, 1),
    }


@both_backends
@pytest.mark.parametrize("angle", [0.0, 0.4, 2.8, 3.5, -0.7])
def test_normals_are_shortest_axes_turned_to_the_camera(backend, angle):
    arguments = _disc(angle) | cameras()
    shape = [arguments[name] for name in ("means", "quats", "scales", "viewmats")]
    axis = torch.tensor([math.sin(angle), 0.0, math.cos(angle)])
    expected = axis * -torch.sign(axis[2])
    torch.testing.assert_close(facing_axes(*shape)[0, 0], expected)
    _, alpha, meta = rasterization(**arguments, backend=backend)
    picture = normals(meta, *shape)
    assert picture.shape == (1, HEIGHT, WIDTH, 3)
    seen = alpha[..., 0] > 0.0
    assert seen.any()
    torch.testing.assert_close(picture[seen].float(), expected.expand(int(seen.sum()), 3), rtol=0, atol=1e-4)
    assert picture.isfinite().all()
    assert (picture[~seen] == 0.0).all()


@pytest.mark.parametrize(("length", "counts"), [(1e-40, False), (1e-29, True), (1e-21, True), (1e25, True)])
def test_normals_are_of_quaternions_that_are_rotations(length, counts):
    shape = _disc(0.4) | cameras()
    expected = facing_axes(*(shape[name] for name in ("means", "quats", "scales", "viewmats")))
    shape["quats"] = (shape["quats"].double() * length).float()
    found = facing_axes(*(shape[name] for name in ("means", "quats", "scales", "viewmats")))
    torch.testing.assert_close(found, expected if counts else torch.zeros_like(expected))


def test_normals_turn_with_the_camera_and_face_each():
    arguments = scene(views=2)
    turn = torch.tensor([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    viewmats = torch.stack([arguments["viewmats"][0], turn])
    shape = [arguments[name] for name in ("means", "quats", "scales")]
    axes = facing_axes(*shape, viewmats)
    assert axes.shape == (2, 40, 3)
    positions = torch.einsum("cij,nj->cni", viewmats[:, :3, :3], arguments["means"]) + viewmats[:, None, :3, 3]
    assert ((axes * positions).sum(-1) <= 1e-6).all()
    in_world = torch.einsum("cji,cnj->cni", viewmats[:, :3, :3], axes)
    torch.testing.assert_close(in_world[0].abs(), in_world[1].abs())


@both_backends
def test_normals_in_one_call_with_colours_are_those_of_two(backend):
    arguments = scene()
    shape = [arguments[name] for name in ("means", "quats", "scales", "viewmats")]
    _, _, meta = rasterization(**arguments, backend=backend)
    colors = torch.cat([arguments["colors"][None], facing_axes(*shape)], dim=-1)
    image, _, _ = rasterization(**arguments | {"colors": colors}, backend=backend)
    alone = normals(meta, *shape)
    together = torch.nn.functional.normalize(image[..., 3:], dim=-1)
    clear = image[..., 3:].norm(dim=-1) > 0.05
    torch.testing.assert_close(alone[clear], together[clear], rtol=0, atol=1e-4)


@both_backends
def test_normals_have_finite_gradients(backend):
    arguments = scene(count=15)
    arguments["quats"][3] = 0.0
    arguments = with_gradients(arguments, "means", "quats", "scales", "viewmats")
    _, _, meta = rasterization(**arguments, backend=backend)
    shape = [arguments[name] for name in ("means", "quats", "scales", "viewmats")]
    normals(meta, *shape)[..., 2].sum().backward()
    for tensor in shape:
        assert tensor.grad.isfinite().all()
    assert arguments["quats"].grad.abs().max() > 0.0
