"""What cannot mean anything, and what gsplat has and we have not, is refused by its name."""

from __future__ import annotations

import enum
import math

import numpy as np
import pytest
import torch

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.cpu.blending.splats import pack_splats
from hybridworldsim.rasterizer.cpu.blending.tiles import assign_tiles
from hybridworldsim.rasterizer.inputs import check_inputs
from hybridworldsim.rasterizer.limits import GAUSSIANS_MAX, SIDE_MAX, refuse_too_many
from hybridworldsim.rasterizer.rows import scatter_rows, take_rows
from mirror.errors import UsageError
from tests.rasterizer.scenes import both_backends, cameras, one, scene, with_gradients

_SQUARE = {"width": 16, "height": 16}


def _tables(arguments):
    return {name: arguments[name] for name in ("means", "quats", "scales", "opacities", "colors")}


def _refused(place, match="", **changes):
    with pytest.raises(UsageError, match=match) as caught:
        rasterization(**scene(count=7, views=2) | {"backend": "reference"} | changes)
    assert caught.value.place == place
    return caught.value


@pytest.mark.parametrize(
    ("name", "value", "shape"),
    [
        ("means", torch.zeros(7, 2), r"\(7, 3\)"),
        ("means", torch.zeros(3), r"\(\.\.\., N, 3\)"),
        ("quats", torch.zeros(6, 4), r"\(7, 4\)"),
        ("scales", torch.zeros(7, 1), r"\(7, 3\)"),
        ("opacities", torch.zeros(7, 1), r"\(7,\)"),
        ("colors", torch.zeros(6, 3), r"\(7, D\) or \(2, 7, D\)"),
        ("colors", torch.zeros(7, 0), "at least one channel"),
        ("viewmats", torch.eye(4), r"\(\.\.\., C, 4, 4\)"),
        ("viewmats", torch.zeros(0, 4, 4), "at least one camera"),
        ("Ks", torch.zeros(1, 3, 3), r"\(2, 3, 3\)"),
        ("backgrounds", torch.zeros(2, 4), r"\(2, 3\)"),
        ("backgrounds", torch.zeros(3), r"\(2, 3\)"),
    ],
)
def test_shapes_that_do_not_fit_are_named_with_what_fits(name, value, shape):
    error = _refused(name, shape, **{name: value})
    assert str(tuple(value.shape)) in error.problem


def test_a_background_has_a_channel_for_each_feature():
    arguments = scene(count=7, views=2, channels=5) | {"backend": "reference"}
    plain, alpha, _ = rasterization(**arguments)
    backgrounds = torch.linspace(0.0, 1.0, 10).reshape(2, 5)
    over = rasterization(**arguments, backgrounds=backgrounds)[0]
    torch.testing.assert_close(over, plain + (1.0 - alpha) * backgrounds[:, None, None])
    with pytest.raises(UsageError, match=r"\(2, 5\)"):
        rasterization(**arguments, backgrounds=backgrounds[:, :3])


@pytest.mark.parametrize(
    ("degree", "bases", "match"), [(2, 8, "K of at least 9"), (5, 36, "0 to 4"), (-1, 4, "0 to 4")]
)
def test_harmonics_need_enough_coefficients(degree, bases, match):
    with pytest.raises(UsageError, match=match):
        rasterization(**scene(count=7) | {"colors": torch.zeros(7, bases, 3)}, sh_degree=degree, backend="reference")


@pytest.mark.parametrize("name", ["means", "colors", "viewmats"])
def test_only_floating_point_tensors(name):
    _refused(name, "float32 or float64", **{name: scene(7, 2)[name].half()})
    _refused(name, "a torch tensor", **{name: scene(7, 2)[name].numpy()})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", 0),
        ("height", -3),
        ("width", 2.5),
        ("height", 21.0),
        ("width", True),
        ("width", "37"),
        ("tile_size", 0),
    ],
)
def test_sizes_are_whole_and_positive(name, value):
    _refused(name, "at least 1", **{name: value})


@both_backends
@pytest.mark.parametrize(
    ("width", "height", "place"),
    [
        (10**9, 10**9, "width"),
        (37, 10**9, "height"),
        (SIDE_MAX + 1, 1, "width"),
        (2**14 + 1, 2**14, "width, height"),
        (2**63, 1, "width"),
    ],
)
def test_images_too_large_to_be_held_are_refused_with_the_limit(backend, width, height, place):
    error = _refused(place, "pixels", width=width, height=height, backend=backend)
    assert "at most" in error.expected
    assert "cx" in error.remedy


@pytest.mark.parametrize("side", ["width", "height"])
def test_the_longest_side_is_drawn_to_its_end(side):
    far = one((0.0, 0.0, 2.0), 0.5, 0.9, (1.0,)) | cameras()
    size = {"width": 16, "height": 16} | {side: SIDE_MAX}
    axis = 0 if side == "width" else 1
    far["Ks"] = torch.tensor([[[10.0, 0.0, 8.0], [0.0, 10.0, 8.0], [0.0, 0.0, 1.0]]])
    far["Ks"][0, axis, 2] = SIDE_MAX - 8.0
    image, _, _ = rasterization(**far | size, backend="cpu")
    near, _, _ = rasterization(**far | {"Ks": torch.tensor([[[10.0, 0, 8], [0, 10.0, 8], [0, 0, 1]]]), **_SQUARE})
    end = image[:, :, -16:] if side == "width" else image[:, -16:]
    assert near.max() > 0.5
    torch.testing.assert_close(end, near, rtol=0, atol=1e-5)


def test_more_gaussians_than_can_be_numbered_are_refused():
    many = {name: tensor[:1].expand(2**31, *tensor.shape[1:]) for name, tensor in _tables(scene(1)).items()}
    with pytest.raises(UsageError, match="2147483648 Gaussians") as caught:
        rasterization(**scene(1) | many)
    assert caught.value.place == "means"


def test_more_pairs_than_can_be_counted_are_refused():
    tiles_x, tiles_y, count = 512, 512, 8192  # 2^31 pairs
    splats = pack_splats(
        np.full((count, 2), 4096.0, np.float32), np.zeros((count, 2), np.float32),
        np.tile([1e-6, 0.0, 1e-6], (count, 1)), np.ones(count, np.float32), np.zeros((count, 1), np.float32),
        np.full((count, 2), 1 << 30, np.int32), tiles_x, tiles_y,
    )  # fmt: skip
    order, every = np.arange(count, dtype=np.int32), np.ones(tiles_x * tiles_y, np.bool_)
    with pytest.raises(UsageError, match="pairs of a tile"):
        assign_tiles(splats, order, tiles_x, every)


@pytest.mark.parametrize(
    ("name", "value"),
    [("eps2d", -0.1), ("radius_clip", -1.0), ("near_plane", float("nan")), ("near_plane", -1.0), ("far_plane", 0.001)],
)
def test_numbers_that_mean_nothing_are_refused(name, value):
    _refused(name, "at least", **{name: value})


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("render_mode", "'RGB' or 'D'"),
        ("rasterize_mode", "'classic' or 'antialiased'"),
        ("camera_model", "'pinhole' or 'fisheye'"),
        ("backend", "'auto' or 'cuda'"),
        ("nonfinite", "'raise' or 'cull'"),
        ("preset", "gsplat-1.3 or gsplat-1.5 or gsplat-1.6"),
    ],
)
def test_unknown_words_are_answered_with_the_known_ones(name, match):
    _refused(name, match, **{name: "ortho"})


class _Shutter(enum.Enum):
    GLOBAL = 4


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sparse_grad", True),
        ("distributed", True),
        ("covars", torch.eye(3).repeat(7, 1, 1)),
        ("with_eval3d", True),
        ("ftheta_coeffs", object()),
    ],
)
def test_what_gsplat_has_and_we_have_not_is_never_ignored(name, value):
    error = _refused(name, "gsplat has this", **{name: value})
    assert error.expected


def test_arguments_of_gsplat_that_change_no_result_change_none():
    plain, _, _ = rasterization(**scene(), backend="reference")
    received, _, _ = rasterization(
        **scene(), backend="reference", channel_chunk=1, segmented=True, rolling_shutter=_Shutter.GLOBAL
    )
    assert torch.equal(plain, received)


def test_colours_are_needed_unless_depth_alone_is_asked_for():
    _refused("colors", "render_mode needs colours", colors=None)


def test_a_camera_that_is_no_camera_is_refused():
    _refused("viewmats", "singular", viewmats=torch.zeros(2, 4, 4))
    broken = scene(7, 2)["Ks"]
    broken[1, 0, 0] = torch.nan
    _refused("Ks", "1 of 2 rows hold NaN or infinity: image 1", Ks=broken)


def test_planes_the_wrong_way_round_and_flags_that_are_none_are_named():
    _refused("far_plane", "at 1.0 m is nearer than the near plane at 2.0 m", near_plane=2.0, far_plane=1.0)
    _refused("near_plane", "at least 0", near_plane=-1.0)
    _refused("far_plane", "nan", far_plane=float("nan"))
    for name in ("packed", "absgrad", "with_ut"):
        _refused(name, "no bool", **{name: "x"})
    rasterization(**scene(), packed=np.True_, backend="reference")


def test_broken_colours_are_counted_among_the_visible_ones():
    colors = scene(count=7, views=2)["colors"].clone()
    colors[:] = torch.nan
    _refused("colors", r"\d of \d visible rows hold NaN", colors=colors)


def test_lenses_need_the_unscented_transform():
    _refused("radial_coeffs", "with_ut", radial_coeffs=torch.zeros(2, 6))
    _refused("camera_model", "with_ut", camera_model="fisheye")
    _refused("radial_coeffs", "6 finite numbers", with_ut=True, radial_coeffs=torch.zeros(2, 5))
    _refused("radial_coeffs", r"\(2, coefficients\)", with_ut=True, radial_coeffs=torch.zeros(1, 6))
    _refused("tangential_coeffs", "fisheye", with_ut=True, camera_model="fisheye", tangential_coeffs=torch.ones(2, 2))


@both_backends
def test_each_camera_has_its_own_lens(backend):
    arguments = scene(views=2) | {"backend": backend, "with_ut": True}
    arguments["scales"] = arguments["scales"] * 0.3
    coefficients = torch.tensor([[0.2, 0.0, 0.0, 0.0, 0.0, 0.0], [-0.1, 0.02, 0.0, 0.0, 0.0, 0.0]])
    both, _, _ = rasterization(**arguments, radial_coeffs=coefficients, tangential_coeffs=torch.full((2, 2), 0.01))
    for camera in range(2):
        own = {name: arguments[name][[camera]] for name in ("viewmats", "Ks")}
        lens = {"radial_coeffs": coefficients[[camera]], "tangential_coeffs": torch.full((1, 2), 0.01)}
        alone, _, _ = rasterization(**arguments | own | lens)
        assert torch.equal(both[camera], alone[0])
    assert not torch.equal(both[0], rasterization(**arguments)[0][0])


@both_backends
@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_is_named_with_its_index(backend, name, value):
    arguments = scene(count=40, views=2)
    seen = rasterization(**arguments, backend=backend)[2]["gaussian_ids"].unique().tolist()
    bad = seen[1:7]
    arguments[name][bad] = value
    with pytest.raises(UsageError, match="NaN or infinity") as caught:
        rasterization(**arguments, backend=backend)
    assert caught.value.place == name
    assert ", ".join(map(str, bad[:3])) in caught.value.problem
    assert caught.value.problem.endswith("...")
    assert "cull" in str(caught.value)


def test_harmonics_that_are_not_finite_are_named():
    arguments = scene()
    seen = rasterization(**arguments, backend="reference")[2]["gaussian_ids"]
    arguments["colors"] = torch.zeros(40, 9, 3)
    arguments["colors"][seen[3], 2, 1] = torch.inf
    with pytest.raises(UsageError, match=f"Gaussian {seen[3]}") as caught:
        rasterization(**arguments, backend="reference", sh_degree=1)
    assert caught.value.place == "colors"


def test_numbers_whose_sum_overflows_are_finite():
    arguments = scene()
    arguments["means"][:3] = torch.finfo(torch.float32).max
    rasterization(**arguments, backend="reference")


@both_backends
@pytest.mark.parametrize("packed", [True, False])
def test_culling_leaves_out_what_is_not_finite_and_counts_it(backend, packed):
    arguments = scene(count=40, views=2)
    bad = {"means": 3, "quats": 7, "scales": 11, "opacities": 20, "colors": 33}
    good = [row for row in range(40) if row not in bad.values()]
    names = ("means", "quats", "scales", "opacities", "colors")
    without = arguments | {name: arguments[name][good] for name in names}
    expected, alpha_expected, few = rasterization(**without, backend=backend, packed=packed, render_mode="RGB+D")

    for name, row in bad.items():
        arguments[name][row] = torch.nan
    trained = with_gradients(arguments, *names)
    image, alpha, meta = rasterization(**trained, backend=backend, packed=packed, render_mode="RGB+D", nonfinite="cull")
    assert torch.equal(image, expected)
    assert torch.equal(alpha, alpha_expected)
    assert meta["counts"]["nonfinite"] == 2 * len(bad)
    if packed:
        assert torch.equal(meta["gaussian_ids"], torch.tensor(good)[few["gaussian_ids"]])
    else:
        assert torch.equal(meta["means2d"][:, good], few["means2d"])
        assert (meta["radii"][:, list(bad.values())] == 0).all()
    (image.sum() + alpha.sum()).backward()
    for name in names:
        gradient = trained[name].grad
        assert gradient.isfinite().all()
        assert (gradient[list(bad.values())] == 0.0).all()


def test_culling_costs_nothing_where_all_is_finite():
    plain, _, meta = rasterization(**scene(), backend="reference")
    culled, _, counted = rasterization(**scene(), backend="reference", nonfinite="cull")
    assert torch.equal(plain, culled)
    assert meta["counts"] == counted["counts"]


def test_rows_are_taken_and_spread_with_gradients():
    table = torch.randn(6, 2, dtype=torch.float64, requires_grad=True)
    ids = torch.tensor([0, 2, 5])
    assert take_rows(table, torch.arange(6)) is table
    assert scatter_rows(table, torch.arange(6), 6) is table
    assert torch.equal(scatter_rows(take_rows(table, ids), ids, 6)[ids], table[ids])
    assert torch.autograd.gradcheck(lambda x: take_rows(x, ids), table)
    assert torch.autograd.gradcheck(lambda x: scatter_rows(x[:3], ids, 6), table)


def test_the_largest_count_of_gaussians_is_accepted() -> None:
    refuse_too_many(GAUSSIANS_MAX)
    with pytest.raises(UsageError, match="Gaussians"):
        refuse_too_many(GAUSSIANS_MAX + 1)


def test_a_row_with_one_number_that_is_not_finite_is_found() -> None:
    given = scene(6, seed=3)
    given["means"] = given["means"].clone()
    given["means"][2, 1] = math.nan
    inputs = check_inputs(**given, sh_degree=None, backgrounds=None, render_mode="RGB", nonfinite="cull")
    found = inputs.find_finite(0, 0)
    assert found is not None
    assert found.tolist() == [0, 1, 3, 4, 5]
