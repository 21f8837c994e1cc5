"""`meta` holds what gsplat's does, and gradients pass through its means."""

from __future__ import annotations

import gc
import weakref

import pytest
import torch

from hybridworldsim.rasterizer import rasterization
from tests.rasterizer.scenes import HEIGHT, WIDTH, both_backends, scene, with_gradients

GSPLAT = {
    "batch_ids", "camera_ids", "gaussian_ids", "radii", "means2d", "depths", "conics", "opacities", "tile_width",
    "tile_height", "tile_size", "width", "height", "n_batches", "n_cameras",
}  # fmt: skip


@both_backends
def test_packed_lists_what_each_camera_sees(backend):
    arguments = scene(views=3)
    _, _, meta = rasterization(**arguments, backend=backend)
    count = len(meta["gaussian_ids"])
    assert set(meta) >= GSPLAT
    assert 0 < count < 3 * 40
    assert [meta[name].dtype for name in ("camera_ids", "gaussian_ids", "radii")] == [
        torch.int64, torch.int64, torch.int32,
    ]  # fmt: skip
    for name, shape in {
        "batch_ids": (),
        "camera_ids": (),
        "gaussian_ids": (),
        "radii": (2,),
        "means2d": (2,),
        "depths": (),
        "conics": (3,),
        "opacities": (),
    }.items():
        assert meta[name].shape == (count, *shape), name
    assert (meta["radii"] > 0).all()
    keys = meta["camera_ids"] * 40 + meta["gaussian_ids"]
    assert (keys.diff() > 0).all()
    assert torch.equal(meta["opacities"].float(), arguments["opacities"][meta["gaussian_ids"]])
    assert (meta["tile_width"], meta["tile_height"], meta["tile_size"]) == (3, 2, 16)
    assert (meta["width"], meta["height"], meta["n_cameras"], meta["n_batches"]) == (WIDTH, HEIGHT, 3, 1)


@both_backends
def test_unpacked_is_packed_where_it_belongs_and_zero_elsewhere(backend):
    _, _, packed = rasterization(**scene(views=3), backend=backend)
    _, _, whole = rasterization(**scene(views=3), backend=backend, packed=False)
    assert set(whole) == set(packed)
    places = (packed["camera_ids"], packed["gaussian_ids"])
    for name, shape in {"radii": (2,), "means2d": (2,), "depths": (), "conics": (3,), "opacities": ()}.items():
        assert whole[name].shape == (3, 40, *shape), name
        assert torch.equal(whole[name][places], packed[name]), name
    unseen = torch.ones(3, 40, dtype=torch.bool)
    unseen[places] = False
    assert (whole["radii"][unseen] == 0).all()
    assert torch.equal((whole["radii"] > 0).all(-1), ~unseen)
    assert whole["camera_ids"] is whole["gaussian_ids"] is whole["batch_ids"] is None


@both_backends
def test_every_gaussian_is_seen_or_culled_for_one_cause(backend):
    arguments = scene(views=2)
    arguments["means"][:5] = torch.tensor([0.0, 0.0, 3.0])
    arguments["opacities"][:3] = 0.0
    arguments["quats"][3] = 0.0
    arguments["means"][4, 2] = 1e6
    arguments["means"][5, 2] = -2.0
    _, _, meta = rasterization(**arguments, backend=backend, far_plane=1e5)
    counts = meta["counts"]
    causes = ("near", "far", "frustum", "radius", "opacity", "degenerate")
    assert sum(counts[cause] for cause in causes) + len(meta["gaussian_ids"]) == 2 * 40
    assert all(counts[cause] > 0 for cause in ("near", "far", "frustum", "opacity", "degenerate"))
    assert counts["pairs"] >= counts["processed_pairs"] > 0


@both_backends
@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("packed", [True, False])
def test_gradients_of_means2d_are_kept_with_absolute_ones(backend, views, packed):
    arguments = with_gradients(scene(views=views), "means")
    image, _, meta = rasterization(**arguments, backend=backend, packed=packed, absgrad=True)
    means2d = meta["means2d"]
    means2d.retain_grad()
    image.square().sum().backward()
    assert means2d.grad.shape == means2d.absgrad.shape == means2d.shape
    assert means2d.grad.dtype == means2d.absgrad.dtype == means2d.dtype
    assert (means2d.absgrad >= means2d.grad.abs() * (1.0 - 1e-4)).all()
    assert means2d.absgrad.sum() > 1.2 * means2d.grad.abs().sum()
    if not packed:
        assert (means2d.absgrad[meta["radii"].amax(-1) == 0] == 0.0).all()


@both_backends
def test_absolute_gradients_are_those_of_each_camera(backend):
    arguments = with_gradients(scene(views=2), "means")
    image, _, meta = rasterization(**arguments, backend=backend, absgrad=True)
    image.square().sum().backward()
    for camera in range(2):
        own = {name: arguments[name][[camera]] for name in ("viewmats", "Ks")}
        alone, _, own_meta = rasterization(**arguments | own, backend=backend, absgrad=True)
        alone.square().sum().backward()
        assert torch.equal(meta["means2d"].absgrad[meta["camera_ids"] == camera], own_meta["means2d"].absgrad)


@both_backends
def test_a_camera_that_the_loss_leaves_out_has_no_absolute_gradient(backend):
    arguments = with_gradients(scene(views=2), "means")
    image, _, meta = rasterization(**arguments, backend=backend, absgrad=True)
    image[0].sum().backward()
    absolute, camera = meta["means2d"].absgrad, meta["camera_ids"]
    assert absolute[camera == 0].sum() > 0.0
    assert (absolute[camera == 1] == 0.0).all()


@both_backends
def test_gradients_of_means2d_are_those_of_a_shift_of_the_image(backend):
    # moving all means by one pixel moves the principal point
    arguments = with_gradients(scene(), "means")
    image, _, meta = rasterization(**arguments, backend=backend)
    meta["means2d"].retain_grad()
    weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1), dtype=image.dtype)
    (image * weights).sum().backward()
    step = 1e-4
    arguments = {k: v.detach().double() if isinstance(v, torch.Tensor) else v for k, v in arguments.items()}
    sums = []
    for shift in (-step, step):
        ks = arguments["Ks"].clone()
        ks[:, 0, 2] += shift
        moved, _, _ = rasterization(**arguments | {"Ks": ks}, backend="reference")
        sums.append((moved * weights.double()).sum())
    expected = (sums[1] - sums[0]) / (2.0 * step)
    assert meta["means2d"].grad[:, 0].sum().double() == pytest.approx(float(expected), rel=0.02)


def test_radii_of_the_oldest_preset_are_single_numbers():
    _, _, packed = rasterization(**scene(), backend="reference", preset="gsplat-1.3")
    _, _, whole = rasterization(**scene(), backend="reference", preset="gsplat-1.3", packed=False)
    assert packed["radii"].shape == packed["gaussian_ids"].shape
    assert whole["radii"].shape == (1, 40)


@both_backends
@pytest.mark.parametrize("packed", [True, False])
def test_nothing_is_held_once_it_is_let_go(backend, packed):
    arguments = with_gradients(scene(views=2), "means", "opacities")
    gc.collect()
    gc.disable()
    try:
        for backwards in (False, True):
            image, _, meta = rasterization(**arguments, backend=backend, packed=packed, absgrad=True)
            if backwards:
                image.sum().backward()
            held = weakref.ref(meta["means2d"])
            del image, meta, _
            assert held() is None
    finally:
        gc.enable()
