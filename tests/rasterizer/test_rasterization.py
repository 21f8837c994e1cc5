"""`rasterization` against closed forms and against what gsplat's words promise."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.rasterizer import rasterization
from mirror.errors import UsageError
from tests.draws import draws
from tests.rasterizer.scenes import (
    BACKENDS,
    FOCAL,
    HEIGHT,
    WIDTH,
    both_backends,
    cameras,
    concatenate,
    gaussians,
    one,
    scene,
    with_gradients,
)

TRAINED = ("means", "quats", "scales", "opacities", "colors", "viewmats")
TOLERANCE = {"reference": 1e-12, "cpu": 2e-6}


def _alpha(depth, scale, opacity, width=WIDTH, height=HEIGHT):
    """A round Gaussian on the axis of `cameras()`, by hand."""
    x = torch.arange(width, dtype=torch.float64)[None, :] + 0.5 - 0.4375 * width
    y = torch.arange(height, dtype=torch.float64)[:, None] + 0.5 - 0.5625 * height
    variances = [(focal * scale / depth) ** 2 + 0.3 for focal in (FOCAL, FOCAL + 2.0)]
    alpha = opacity * torch.exp(-0.5 * (x**2 / variances[0] + y**2 / variances[1]))
    return torch.where(alpha >= 1.0 / 255.0, alpha, 0.0)


def _double(arguments):
    return {name: value.double() if isinstance(value, torch.Tensor) else value for name, value in arguments.items()}


@both_backends
def test_one_gaussian_is_what_the_closed_form_says(backend):
    arguments = _double(one((0.0, 0.0, 3.0), 0.25, 0.5, (0.25, 1.0, 0.5)) | cameras())
    image, alpha, _ = rasterization(**arguments, backend=backend, render_mode="RGB+D")
    expected = _alpha(3.0, 0.25, 0.5)
    factors = torch.tensor([0.25, 1.0, 0.5, 3.0], dtype=torch.float64)
    assert image.shape == (1, HEIGHT, WIDTH, 4)
    torch.testing.assert_close(alpha[0, ..., 0].double(), expected, rtol=0, atol=3 * TOLERANCE[backend])
    torch.testing.assert_close(image[0].double(), expected[..., None] * factors, rtol=0, atol=9 * TOLERANCE[backend])


@pytest.mark.parametrize(("width", "height"), [(720, 408), (722, 404)])
def test_a_large_image_with_empty_tiles_is_what_the_closed_form_says(width, height):
    """Large images of whole cache lines are written past the caches. An earlier image left its blocks in memory."""
    rasterization(**_double(one((0.0, 0.0, 0.6), 2.0, 0.9, (1.0,)) | cameras(1, width, height)), render_mode="RGB+D")
    for scale in (0.02, 0.25):
        arguments = _double(one((0.0, 0.0, 3.0), scale, 0.5, (0.25, 1.0, 0.5)) | cameras(1, width, height))
        arguments["colors"].requires_grad_()
        image, alpha, _ = rasterization(**arguments, render_mode="RGB+D")
        expected = _alpha(3.0, scale, 0.5, width, height)
        factors = torch.tensor([0.25, 1.0, 0.5, 3.0], dtype=torch.float64)
        torch.testing.assert_close(alpha[0, ..., 0].double(), expected, rtol=0, atol=6e-6)
        torch.testing.assert_close(image[0].double(), expected[..., None] * factors, rtol=0, atol=2e-5)
        weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1))
        (gradient,) = torch.autograd.grad((image * weights).sum(), arguments["colors"])
        by_hand = (expected[..., None] * weights[0, ..., :3]).sum((0, 1))
        torch.testing.assert_close(gradient.reshape(3), by_hand, rtol=2e-5, atol=0)


@both_backends
def test_the_nearer_of_two_is_in_front_whichever_comes_first(backend):
    near, far = one((0.0, 0.0, 2.0), 0.2, 0.5, (1.0,)), one((0.0, 0.0, 4.0), 0.5, 0.75, (0.5,))
    first, second = _alpha(2.0, 0.2, 0.5), _alpha(4.0, 0.5, 0.75)
    expected = first + (1.0 - first) * second * 0.5
    for order in ((near, far), (far, near)):
        image, alpha, _ = rasterization(**_double(concatenate(*order) | cameras()), backend=backend)
        torch.testing.assert_close(image[0, ..., 0].double(), expected, rtol=0, atol=3e-6)
        torch.testing.assert_close(alpha[0, ..., 0].double(), 1 - (1 - first) * (1 - second), rtol=0, atol=3e-6)


@both_backends
def test_antialiasing_shrinks_opacity_by_what_the_blur_adds(backend):
    arguments = _double(one((0.0, 0.0, 3.0), 0.05, 0.5, (1.0,)) | cameras())
    _, alpha, meta = rasterization(**arguments, backend=backend, rasterize_mode="antialiased")
    variances = [(focal * 0.05 / 3.0) ** 2 for focal in (FOCAL, FOCAL + 2.0)]
    factor = math.sqrt(math.prod(variances) / math.prod(variance + 0.3 for variance in variances))
    assert meta["opacities"].item() == pytest.approx(0.5 * factor, rel=1e-5)
    torch.testing.assert_close(alpha[0, ..., 0].double(), _alpha(3.0, 0.05, 0.5 * factor), rtol=0, atol=3e-6)


@both_backends
def test_backgrounds_are_seen_through_but_not_in_depth(backend):
    arguments = scene(views=2)
    image, alpha, _ = rasterization(**arguments, backend=backend, render_mode="RGB+D")
    backgrounds = torch.tensor([[0.25, 0.5, 1.0], [1.0, 0.0, 0.5]])
    over, same_alpha, _ = rasterization(**arguments, backend=backend, render_mode="RGB+D", backgrounds=backgrounds)
    expected = image[..., :3] + (1.0 - alpha) * backgrounds[:, None, None]
    torch.testing.assert_close(over[..., :3], expected.to(over.dtype), rtol=0, atol=1e-6)
    assert torch.equal(over[..., 3], image[..., 3])
    assert torch.equal(alpha, same_alpha)


@both_backends
@pytest.mark.parametrize("mode", ["D", "ED"])
def test_depth_alone_needs_no_colours_and_ignores_backgrounds(backend, mode):
    arguments = scene() | {"backgrounds": torch.ones(1, 3)}
    colored, _, _ = rasterization(**arguments, backend=backend, render_mode=f"RGB+{mode}")
    depth, _, _ = rasterization(**arguments | {"colors": None}, backend=backend, render_mode=mode)
    assert depth.shape == (1, HEIGHT, WIDTH, 1)
    torch.testing.assert_close(depth[..., 0], colored[..., 3], rtol=1e-6, atol=1e-6)


@both_backends
def test_expected_depth_is_depth_by_alpha_and_zero_where_nothing_is(backend):
    arguments = scene(count=6)
    depth, alpha, meta = rasterization(**arguments, backend=backend, render_mode="D")
    expected, _, _ = rasterization(**arguments, backend=backend, render_mode="ED")
    empty = alpha == 0.0
    assert empty.any()
    assert not empty.all()
    assert (expected[empty] == 0.0).all()
    torch.testing.assert_close(expected, depth / alpha.clamp(min=1e-10))
    seen = meta["depths"]
    assert (expected[~empty] >= seen.min() - 1e-5).all()
    assert (expected[~empty] <= seen.max() + 1e-5).all()


@both_backends
def test_packed_or_not_is_the_same_to_the_bit(backend):
    found = []
    for packed in (True, False):
        arguments = with_gradients(scene(views=2), *TRAINED)
        image, alpha, _ = rasterization(**arguments, backend=backend, packed=packed, render_mode="RGB+ED")
        (image.sum() + alpha.square().sum()).backward()
        found.append([image, alpha, *(arguments[name].grad for name in TRAINED)])
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


@both_backends
def test_several_cameras_are_each_alone(backend):
    arguments = scene(views=3)
    image, alpha, _ = rasterization(**arguments, backend=backend)
    for camera in range(3):
        own = {name: arguments[name][camera : camera + 1] for name in ("viewmats", "Ks")}
        alone, alpha_alone, _ = rasterization(**arguments | own, backend=backend)
        assert torch.equal(image[camera], alone[0])
        assert torch.equal(alpha[camera], alpha_alone[0])


@both_backends
@pytest.mark.parametrize("packed", [True, False])
def test_leading_dimensions_are_scenes_of_their_own(backend, packed):
    scenes = [scene(count=12, views=2, seed=seed) for seed in range(6)]
    names = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")
    joint = {name: torch.stack([part[name] for part in scenes]).unflatten(0, (2, 3)) for name in names}
    image, alpha, meta = rasterization(**scenes[0] | joint, backend=backend, packed=packed, render_mode="RGB+D")
    assert image.shape == (2, 3, 2, HEIGHT, WIDTH, 4)
    assert (meta["n_batches"], meta["n_cameras"]) == (6, 2)
    for number, part in enumerate(scenes):
        alone, alpha_alone, own = rasterization(**part, backend=backend, packed=packed, render_mode="RGB+D")
        assert torch.equal(image.flatten(0, 1)[number], alone)
        assert torch.equal(alpha.flatten(0, 1)[number], alpha_alone)
        if packed:
            rows = meta["batch_ids"] == number
            assert torch.equal(meta["gaussian_ids"][rows], own["gaussian_ids"])
            assert torch.equal(meta["camera_ids"][rows], own["camera_ids"])
        else:
            assert torch.equal(meta["means2d"].flatten(0, 1)[number], own["means2d"])


@both_backends
def test_colours_may_be_of_each_camera(backend):
    arguments = scene(views=2)
    colors = torch.stack([arguments["colors"], 1.0 - arguments["colors"]])
    image, _, _ = rasterization(**arguments | {"colors": colors}, backend=backend)
    for camera in range(2):
        alone, _, _ = rasterization(**arguments | {"colors": colors[camera]}, backend=backend)
        assert torch.equal(image[camera], alone[camera])


@both_backends
@pytest.mark.parametrize("channels", [1, 2, 5, 40])
def test_any_number_of_channels(backend, channels):
    arguments = scene(channels=channels)
    image, _, _ = rasterization(**arguments, backend=backend)
    assert image.shape[-1] == channels
    last, _, _ = rasterization(**arguments | {"colors": arguments["colors"][:, -1:]}, backend=backend)
    torch.testing.assert_close(image[..., -1:], last, rtol=0, atol=1e-6)


@both_backends
def test_harmonics_of_degree_zero_are_plain_colours_that_do_not_go_below_black(backend):
    arguments = scene()
    coefficients = torch.randn(40, 4, 3, generator=torch.Generator().manual_seed(3)) * 2.0
    image, _, _ = rasterization(**arguments | {"colors": coefficients}, sh_degree=0, backend=backend)
    colors = (coefficients[:, 0] / (2.0 * math.sqrt(math.pi)) + 0.5).clamp(min=0.0)
    assert (colors == 0.0).any()
    plain, _, _ = rasterization(**arguments | {"colors": colors}, backend=backend)
    torch.testing.assert_close(image, plain, rtol=0, atol=3e-6)


@both_backends
def test_harmonics_look_from_where_the_camera_is(backend):
    # y of degree one is -c1 * y: from below a Gaussian is brighter than from above
    arguments = one((0.0, 0.0, 0.0), 0.3, 0.9, (0.0,)) | cameras(2)
    turned = torch.tensor([[[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 4], [0, 0, 0, 1]]])
    arguments["viewmats"] = torch.cat([turned, torch.diag(torch.tensor([1.0, -1, -1, 1])) @ turned]).clone()
    arguments["viewmats"][1, 2, 3] = 4.0
    coefficients = torch.zeros(1, 4, 3)
    coefficients[0, 1] = 0.5
    image, alpha, _ = rasterization(**arguments | {"colors": coefficients}, sh_degree=1, backend=backend)
    position = -torch.linalg.solve(arguments["viewmats"][:, :3, :3], arguments["viewmats"][:, :3, 3])
    direction = -position / position.norm(dim=-1, keepdim=True)
    expected = 0.5 - math.sqrt(3.0 / (4.0 * math.pi)) * 0.5 * direction[:, 1]
    middle = (HEIGHT * 9 // 16, WIDTH * 7 // 16)
    colors = image[:, *middle, 0] / alpha[:, *middle, 0]
    assert abs(expected[0] - expected[1]) > 0.4
    torch.testing.assert_close(colors.float(), expected, rtol=0, atol=1e-5)


@both_backends
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_reach_every_input_in_its_own_kind(backend, dtype):
    arguments = {k: v.to(dtype) if isinstance(v, torch.Tensor) else v for k, v in scene(views=2).items()}
    arguments["backgrounds"] = torch.rand(2, 3, dtype=dtype)
    names = (*TRAINED, "backgrounds")
    arguments = with_gradients(arguments, *names)
    image, alpha, _ = rasterization(**arguments, backend=backend, render_mode="RGB+ED", rasterize_mode="antialiased")
    (image.square().sum() + alpha.sum()).backward()
    for name in names:
        gradient = arguments[name].grad
        assert gradient.dtype == dtype, name
        assert gradient.isfinite().all(), name
        assert gradient.abs().max() > 0.0, name


def test_what_is_culled_has_no_gradient():
    arguments = with_gradients(scene(), *TRAINED)
    image, _, meta = rasterization(**arguments, backend="reference")
    image.sum().backward()
    culled = torch.ones(40, dtype=torch.bool)
    culled[meta["gaussian_ids"]] = False
    assert culled.any()
    assert all((arguments[name].grad[culled] == 0.0).all() for name in TRAINED[:5])


@pytest.mark.parametrize("degree", [None, 1])
def test_gradients_are_those_of_finite_differences(degree):
    arguments = _double(gaussians(5, seed=2) | cameras(2, 9, 7))
    arguments["means"] = arguments["means"] * torch.tensor([0.15, 0.15, 0.2], dtype=torch.float64) + torch.tensor(
        [0.0, 0.0, 3.0], dtype=torch.float64
    )
    arguments["scales"] = arguments["scales"] * 0.3 + 0.1
    arguments["opacities"] = arguments["opacities"] * 0.3 + 0.2
    if degree is not None:
        arguments["colors"] = (
            torch.randn(5, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 0.2
        )
    arguments["backgrounds"] = torch.full((2, 3), 0.5, dtype=torch.float64)
    names = (*TRAINED, "backgrounds")

    def render(*tensors):
        image, alpha, _ = rasterization(
            **arguments | dict(zip(names, tensors, strict=True)),
            backend="reference",
            render_mode="RGB+D",
            sh_degree=degree,
        )
        # away from the cut at 1/255, where alpha jumps
        return image[..., 1:6, 1:8, :], alpha[..., 1:6, 1:8, :]

    tensors = [arguments[name].clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(render, tensors, eps=1e-6, atol=1e-5, fast_mode=True)


@both_backends
def test_far_from_the_origin_is_as_near_it(backend):
    near = _double(scene())
    far = dict(near)
    offset = torch.tensor([4e6, -7e6, 2e6], dtype=torch.float64)
    far["means"] = near["means"] + offset
    far["viewmats"] = near["viewmats"].clone()
    far["viewmats"][0, :3, 3] -= near["viewmats"][0, :3, :3] @ offset
    colors = {"colors": torch.randn(40, 16, 3, generator=torch.Generator().manual_seed(1)), "sh_degree": 3}
    here, _, _ = rasterization(**near | colors, backend=backend)
    there, _, _ = rasterization(**far | colors, backend=backend)
    assert ((here - there).abs() <= 1e-5).double().mean() > 0.99
    assert (here - there).abs().max() < 0.02


@both_backends
@pytest.mark.parametrize("case", ["no Gaussians", "all behind the camera", "one pixel"])
def test_empty_scenes_and_single_pixels(backend, case):
    width, height = (1, 1) if case == "one pixel" else (WIDTH, HEIGHT)
    arguments = gaussians(0 if case == "no Gaussians" else 10) | cameras(2, width, height)
    if case == "all behind the camera":
        arguments["means"] = arguments["means"] - torch.tensor([0.0, 0.0, 100.0])
    arguments = with_gradients(arguments, *TRAINED)
    backgrounds = torch.tensor([[0.25, 0.5, 0.75]]).repeat(2, 1)
    for packed in (True, False):
        image, alpha, _ = rasterization(
            **arguments, backgrounds=backgrounds, render_mode="RGB+ED", backend=backend, packed=packed
        )
        assert image.shape == (2, height, width, 4)
        assert image.isfinite().all()
        if case != "one pixel":
            assert (alpha == 0.0).all()
            assert torch.equal(image[0, 0, 0].float(), torch.tensor([0.25, 0.5, 0.75, 0.0]))
        image.sum().backward()
        assert arguments["means"].grad.isfinite().all()


@pytest.mark.parametrize(("mode", "degree"), [("RGB", None), ("RGB+ED", None), ("RGB", 2)])
def test_the_backends_agree(mode, degree):
    arguments = scene(views=2, count=200)
    if degree is not None:
        arguments["colors"] = torch.randn(200, 16, 3, generator=torch.Generator().manual_seed(1)) * 0.3
    found = {}
    for backend in BACKENDS:
        trained = with_gradients(arguments, *TRAINED)
        image, alpha, _ = rasterization(**trained, backend=backend, render_mode=mode, sh_degree=degree)
        (image.square().mean() + alpha.mean()).backward()
        found[backend] = (image, alpha, [trained[name].grad for name in TRAINED])
    for exact, fast in zip(found["reference"][:2], found["cpu"][:2], strict=True):
        assert ((exact - fast).abs() <= 2e-5 * exact.abs().max()).double().mean() > 0.999
    for name, exact, fast in zip(TRAINED, found["reference"][2], found["cpu"][2], strict=True):
        assert (exact - fast).norm() <= 1e-3 * exact.norm(), name


@given(
    seed=st.integers(0, 2**31),
    scale=st.floats(-12.0, 6.0),
    distance=st.floats(-3.0, 7.0),
    opacity=st.sampled_from([0.0, 1.0 / 255.0, 0.5, 0.999, 1.0]),
    mode=st.sampled_from(["classic", "antialiased"]),
)
@settings(max_examples=draws(40), deadline=None)
def test_nothing_finite_makes_nan(seed, scale, distance, opacity, mode):
    random = torch.Generator().manual_seed(seed)
    arguments = gaussians(12, seed)
    arguments["means"] = torch.randn(12, 3, generator=random) * 10.0**distance
    arguments["means"][0] = 0.0  # where the camera is
    arguments["means"][1, 2] = 0.0  # on its plane
    arguments["means"][2:5] = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 10.0**distance], [0.0, 0.0, 0.010001]])
    arguments["scales"] = 10.0 ** (scale + 2.0 * torch.randn(12, 3, generator=random))
    arguments["scales"][5], arguments["scales"][6], arguments["quats"][7] = 0.0, -arguments["scales"][6], 0.0
    arguments["opacities"][:] = opacity
    arguments = with_gradients(arguments | cameras(), *TRAINED)
    image, alpha, _ = rasterization(**arguments, backend="cpu", rasterize_mode=mode, render_mode="RGB+ED")
    assert image.isfinite().all()
    assert (alpha >= 0.0).all()
    assert (alpha <= 1.0).all()
    assert (image[..., :3] <= alpha * (1.0 + 1e-5) + 1e-6).all()
    (image.sum() + alpha.sum()).backward()
    for name in TRAINED:
        assert arguments[name].grad.isfinite().all(), name


def test_two_threads_render_at_once():
    scenes = [scene(count=2000, seed=seed) for seed in (1, 2)] * 4

    def render(arguments):
        trained = with_gradients(arguments, *TRAINED)
        image, alpha, _ = rasterization(**trained, backend="cpu", render_mode="RGB+D")
        (image.sum() + alpha.sum()).backward()
        return [image, alpha, *(trained[name].grad for name in TRAINED)]

    alone = [render(arguments) for arguments in scenes]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(render, scenes))
    for one_by_one, at_once in zip(alone, together, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one_by_one, at_once, strict=True))


class _Renders(torch.utils.data.Dataset):
    """Renders where the loader asks for it."""

    def __len__(self):
        return 2

    def __getitem__(self, seed):
        return rasterization(**scene(seed=seed), backend="cpu")[0][0]


def test_a_loaders_worker_renders_after_its_parent_did():
    expected = [_Renders()[seed] for seed in range(2)]
    loader = torch.utils.data.DataLoader(_Renders(), batch_size=None, num_workers=1, multiprocessing_context="spawn")
    assert all(torch.equal(a, b) for a, b in zip(loader, expected, strict=True))


def test_reference_gives_float64_and_cpu_float32():
    kinds = [rasterization(**scene(), backend=backend)[0].dtype for backend in (*BACKENDS, "auto")]
    assert kinds == [torch.float64, torch.float32, torch.float32]


@both_backends
def test_what_a_step_writes_into_parameters_does_not_reach_what_was_rendered(backend):
    shown = gaussians(30) | {"means": torch.rand(30, 3) * 0.4 + torch.tensor([0.0, 0.0, 3.0])}
    arguments = with_gradients(shown | cameras(), "opacities")
    image, _, meta = rasterization(**arguments, backend=backend)
    assert len(meta["gaussian_ids"]) == 30
    kept = meta["opacities"].detach().clone()
    image.sum().backward(retain_graph=True)
    first, arguments["opacities"].grad = arguments["opacities"].grad, None
    with torch.no_grad():
        arguments["opacities"].mul_(0.5)
    assert torch.equal(meta["opacities"].detach(), kept)
    image.sum().backward()
    assert torch.equal(arguments["opacities"].grad, first)


def test_gradients_of_gradients_are_refused():
    arguments = with_gradients(scene(), "opacities")
    image, _, _ = rasterization(**arguments, backend="cpu")
    (gradient,) = torch.autograd.grad(image.square().sum(), arguments["opacities"], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.square().sum().backward()


def test_a_focal_length_of_nothing_is_refused():
    arguments = scene()
    arguments["Ks"][0, 0, 0] = 0.0
    with pytest.raises(UsageError, match="focal length"):
        rasterization(**arguments)
