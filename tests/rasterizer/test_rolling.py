"""Rolling shutters: row times against bisection, ellipses against single rows, kernels against the reference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hybridworldsim.rasterizer import RollingShutterType, rasterization
from hybridworldsim.rasterizer.cpu.projection.project import project as compiled
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference import project as reference
from hybridworldsim.rasterizer.rolling_shutter import ShutterMotion, compute_motion, time_of_pixels
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp, quaternion_from_matrix, slerp
from tests.rasterizer.projections import Inputs, distance, leaves, options, random_gaussians
from tests.rasterizer.scenes import both_backends, scene
from tests.rasterizer.unscented_cameras import HEIGHT, LENSES, WIDTH, K

FAR = torch.eye(4).repeat(2, 1, 1)
FAR[:, 0, 3] = 500.0
TURNED = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0])).repeat(2, 1, 1)
KINDS = [kind for kind in RollingShutterType if kind is not RollingShutterType.GLOBAL]


def end_of(
    viewmat: Tensor, turn: tuple[float, ...] = (0.01, 0.03, -0.005), move: tuple[float, ...] = (0.2, 0.0, -0.4)
) -> Tensor:
    """A pose after a turn and a move."""
    end = viewmat.detach().double().clone()
    end[:3, :3] = torch.from_numpy(matrix_from_quaternion(quaternion_exp(np.array(turn)))) @ end[:3, :3]
    end[:3, 3] += torch.tensor(move, dtype=torch.float64)
    return end


def through(
    project: Any, inputs: Inputs, kind: RollingShutterType, end: Tensor, lens: str = "plain", **how: Any
) -> ProjectedGaussians:
    means, quats, scales, opacities, viewmat = inputs
    shutter = ShutterMotion(*time_of_pixels(kind, WIDTH, HEIGHT), end)
    shape = (means, quats, scales, opacities, viewmat, K, WIDTH, HEIGHT)
    return project(*shape, **(options(**how) | {"lens": LENSES[lens], "shutter": shutter}))


def rows_gradients(projected: ProjectedGaussians, inputs: Inputs, end: Tensor) -> tuple[Tensor, ...]:
    random = torch.Generator().manual_seed(1)
    shown = (projected.means2d, projected.depths, 100.0 * projected.conics)
    weights = [torch.randn(tensor.shape, generator=random, dtype=torch.float64) for tensor in shown]
    total = sum((tensor.double() * weight).sum() for tensor, weight in zip(shown, weights))
    return torch.autograd.grad(total, (*inputs[:3], inputs[4], end))


@pytest.mark.parametrize(("kind", "lens"), list(zip(KINDS, ("everything", "fisheye", "plain", "radial"))))
def test_kernels_give_what_the_reference_gives(kind: RollingShutterType, lens: str) -> None:
    results = []
    for project in (compiled, reference):
        inputs = leaves(random_gaussians(1000))
        end = end_of(inputs[4]).requires_grad_()
        projected = through(project, inputs, kind, end, lens)
        results.append((projected, rows_gradients(projected, inputs, end)))
    (ours, given), (truth, true) = results
    assert len(truth.ids) > 200
    assert torch.equal(ours.ids, truth.ids)
    assert torch.equal(ours.radii, truth.radii)
    assert (ours.means2d.double() + ours.means2d_low - truth.means2d).abs().max() < 1e-5
    assert distance(ours.conics, truth.conics) < 1e-6
    assert distance(ours.depths[:, None], truth.depths[:, None]) < 1e-6
    for mine, right in zip(given, true):
        assert (mine.double() - right).norm() < 1e-5 * right.norm()


def _pose(start: Tensor, end: Tensor, time: float) -> tuple[Float64, Float64]:
    """Rotation and translation of the view matrix at a time, by quaternions as gsplat has it."""
    first, last = (quaternion_from_matrix(pose[:3, :3].detach().numpy()[None])[0] for pose in (start, end))
    rotation = matrix_from_quaternion(slerp(first, last, time))
    translation = (1.0 - time) * start[:3, 3].detach().numpy() + time * end[:3, 3].detach().numpy()
    return rotation, translation


def _pixel(point: Float64, start: Tensor, end: Tensor, time: float) -> Float64:
    rotation, translation = _pose(start, end, time)
    place = rotation @ point + translation
    return np.asarray(K.double().numpy()[:2, :2] @ (place[:2] / place[2]) + K.double().numpy()[:2, 2])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("project", [compiled, reference])
def test_a_point_is_where_it_is_seen_at_the_time_of_its_row(project: Any, kind: RollingShutterType) -> None:
    means, quats, scales, opacities, viewmat = random_gaussians(150, seed=3, dtype=torch.float64)
    end = end_of(viewmat)
    inputs = (means, quats, torch.full_like(scales, 1e-5), torch.ones_like(opacities), viewmat)
    seen = through(project, inputs, kind, end)
    per_x, per_y, offset = time_of_pixels(kind, WIDTH, HEIGHT)
    assert len(seen.ids) > 20
    for row, place in zip(seen.ids.tolist(), seen.means2d.double()):
        low, high = -0.2, 1.2  # bisection to 2^-50 of a readout, far below 1e-9 s
        for _ in range(50):
            middle = 0.5 * (low + high)
            x, y = _pixel(means[row].numpy(), viewmat, end, middle)
            low, high = (middle, high) if per_x * x + per_y * y + offset > middle else (low, middle)
        expected = _pixel(means[row].numpy(), viewmat, end, low)
        if -0.1 < low < 1.1:
            assert np.abs(place.detach().numpy() - expected).max() < 1e-3


def test_times_are_those_of_gsplat_at_the_centres_of_pixels() -> None:
    for row in (0, 7, HEIGHT - 1):
        y = row + 0.5
        assert _time(0, 0.0, y) == pytest.approx(math.floor(y) / (HEIGHT - 1))
        assert _time(2, 0.0, y) == pytest.approx((HEIGHT - math.ceil(y)) / (HEIGHT - 1))
    for column in (0, 7, WIDTH - 1):
        x = column + 0.5
        assert _time(1, x, 0.0) == pytest.approx(math.floor(x) / (WIDTH - 1))
        assert _time(3, x, 0.0) == pytest.approx((WIDTH - math.ceil(x)) / (WIDTH - 1))


def _time(kind: int, x: float, y: float) -> float:
    per_x, per_y, offset = time_of_pixels(RollingShutterType(kind), WIDTH, HEIGHT)
    return per_x * x + per_y * y + offset


@pytest.mark.parametrize("kind", KINDS)
def test_an_ellipse_has_the_moments_of_single_rows(kind: RollingShutterType) -> None:
    """Each row (or column) of the image of a Gaussian is a row of the image of a global shutter at the row's time."""
    means = torch.tensor([[0.3, 0.2, 6.0]], dtype=torch.float64)
    quats = torch.tensor([[0.9, 0.2, -0.3, 0.1]], dtype=torch.float64)
    scales = torch.tensor([[0.12, 0.05, 0.08]], dtype=torch.float64)
    start, opacities = torch.eye(4, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    end = end_of(start, turn=(0.0, 0.02, 0.0), move=(0.5, 0.1, -0.4))
    inputs = (means, quats, scales, opacities, start)
    seen = through(compiled, inputs, kind, end, eps2d=0.0)
    sideways = kind in (RollingShutterType.ROLLING_LEFT_TO_RIGHT, RollingShutterType.ROLLING_RIGHT_TO_LEFT)
    centre = seen.means2d[0].double().numpy()
    spans = [np.arange(-40.0, 40.0, 0.125) + round(float(middle)) for middle in centre]
    density = np.zeros((len(spans[1]), len(spans[0])))
    for place, at in enumerate(spans[0] if sideways else spans[1]):
        time = _time(int(kind), at if sideways else 0.0, 0.0 if sideways else at)
        rotation, translation = _pose(start, end, time)
        view = torch.eye(4, dtype=torch.float64)
        view[:3, :3], view[:3, 3] = torch.from_numpy(rotation), torch.from_numpy(translation)
        still = reference(*inputs[:4], view, K, WIDTH, HEIGHT, **(options(eps2d=0.0) | {"lens": LENSES["plain"]}))
        x, y = still.means2d[0].numpy()
        a, b, c = still.conics[0].numpy()
        dx, dy = (at - x, spans[1] - y) if sideways else (spans[0] - x, at - y)
        # a normalised density: the mass of a Gaussian is the same in each pose
        line = np.exp(-0.5 * (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy)) * math.sqrt(a * c - b * b)
        density[(slice(None), place) if sideways else (place, slice(None))] = line
    density /= density.sum()
    grid_x, grid_y = np.meshgrid(*spans)
    mean = np.array([(density * grid_x).sum(), (density * grid_y).sum()])
    offsets = np.stack([grid_x - mean[0], grid_y - mean[1]])
    expected = np.einsum("hw,ihw,jhw->ij", density, offsets, offsets)
    a, b, c = seen.conics[0].numpy()
    covariance = np.linalg.inv(np.array([[a, b], [b, c]]))
    assert np.abs(covariance - expected).max() < 0.01 * np.abs(expected).max()
    still = reference(*inputs[:4], start, K, WIDTH, HEIGHT, **(options(eps2d=0.0) | {"lens": LENSES["plain"]}))
    a, b, c = still.conics[0].numpy()
    assert np.abs(np.linalg.inv(np.array([[a, b], [b, c]])) - expected).max() > 0.015 * np.abs(expected).max()


def test_gradients_to_both_end_poses_are_those_of_finite_differences() -> None:
    inputs = random_gaussians(200, seed=5, dtype=torch.float64)
    start, kind = inputs[4].clone().requires_grad_(), KINDS[0]
    end = end_of(start).requires_grad_()
    ids = through(reference, inputs, kind, end).ids

    def loss(first: Tensor, last: Tensor) -> Tensor:
        seen = through(reference, (*inputs[:4], first), kind, last)
        place = torch.isin(seen.ids, ids)
        return (seen.means2d[place] * torch.tensor([1.0, -0.7])).sum() + 3.0 * seen.depths[place].sum()

    grads = torch.autograd.grad(loss(start, end), (start, end))
    generators = torch.eye(6, dtype=torch.float64)
    for which, gradient in enumerate(grads):
        for generator in generators:
            direction = torch.zeros(4, 4, dtype=torch.float64)
            x, y, z = generator[:3].tolist()
            skew = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
            pose = (start, end)[which].detach()
            direction[:3, :3], direction[:3, 3] = skew @ pose[:3, :3], generator[3:]
            values = []
            for step in (1e-6, -1e-6):
                moved = [start.detach(), end.detach()]
                moved[which] = pose + step * direction
                values.append(float(loss(*moved)))
            slope = (values[0] - values[1]) / 2e-6
            assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-5, abs=1e-3)


def test_a_camera_at_rest_renders_as_a_global_shutter() -> None:
    inputs = random_gaussians(1000)
    still = through(compiled, inputs, KINDS[0], inputs[4], "fisheye")
    means, quats, scales, opacities, viewmat = inputs
    plain = compiled(
        means, quats, scales, opacities, viewmat, K, WIDTH, HEIGHT, **(options() | {"lens": LENSES["fisheye"]})
    )
    assert torch.equal(still.ids, plain.ids)
    assert (still.means2d - plain.means2d).abs().max() < 1e-4
    assert distance(still.conics, plain.conics.double()) < 1e-7


def test_the_motion_between_poses_is_the_logarithm_of_their_rotation() -> None:
    for size in (1e-9, 1e-3, 0.3, 1.0):
        turn = size * np.array([0.3, -0.5, 0.8])
        start = random_gaussians(1)[4]
        motion = compute_motion(start, end_of(start, tuple(turn.tolist())))
        np.testing.assert_allclose(motion[:3].numpy(), turn, rtol=1e-7, atol=1e-12)


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    threads, results = torch.get_num_threads(), []
    try:
        for number in (1, 3):
            torch.set_num_threads(number)
            inputs = leaves(random_gaussians(40_000))
            end = end_of(inputs[4]).requires_grad_()
            ours = through(compiled, inputs, KINDS[0], end)
            tensors = [tensor for tensor in ours if isinstance(tensor, Tensor)]
            tensors += rows_gradients(ours, inputs, end)
            results.append([tensor.detach().numpy().tobytes() for tensor in tensors])
    finally:
        torch.set_num_threads(threads)
    assert results[0] == results[1]


def _rolling(**changes: Any) -> dict[str, Any]:
    arguments = scene(views=2)
    ends = arguments["viewmats"].clone()
    ends[:, 0, 3] -= 0.3
    rolling = {"with_ut": True, "rolling_shutter": "ROLLING_TOP_TO_BOTTOM", "viewmats_rs": ends}
    return arguments | rolling | changes


@both_backends
def test_an_image_is_made_of_rows_of_global_images(backend: str) -> None:
    arguments = _rolling(backend=backend, sh_degree=None)
    arguments["scales"] = arguments["scales"] * 0.2
    image, _, _ = rasterization(**arguments)
    ends = (arguments["viewmats"], arguments["viewmats_rs"])
    still = {"rolling_shutter": None, "viewmats_rs": None}
    for row in (0, 10, 20):
        time = row / 20
        same, _, _ = rasterization(**arguments | still | {"viewmats": (1.0 - time) * ends[0] + time * ends[1]})
        other, _, _ = rasterization(**arguments | still | {"viewmats": ends[0] if row == 20 else ends[1]})
        near, far = (image - same)[:, row].abs().mean(), (image - other)[:, row].abs().mean()
        assert near < 0.15 * far


@both_backends
def test_the_unscented_transform_antialiases(backend: str) -> None:
    arguments = _rolling(backend=backend)
    classic, _, _ = rasterization(**arguments)
    smooth, _, meta = rasterization(**arguments, rasterize_mode="antialiased")
    assert not torch.equal(classic, smooth)
    assert (meta["opacities"] <= arguments["opacities"][meta["gaussian_ids"]]).all()


@pytest.mark.parametrize(
    ("place", "match", "changes"),
    [
        ("rolling_shutter", "no such shutter", {"rolling_shutter": "TOP"}),
        ("rolling_shutter", "without the unscented transform", {"with_ut": False}),
        ("rolling_shutter", "has no direction ROLLING_TOP_TO_BOTTOM", {"height": 1}),
        ("viewmats_rs", "without the poses at the last row", {"viewmats_rs": None}),
        ("viewmats_rs", "with a global shutter", {"rolling_shutter": None}),
        ("viewmats_rs", "shape", {"viewmats_rs": torch.eye(4)[None]}),
        ("viewmats_rs", "NaN", {"viewmats_rs": torch.full((2, 4, 4), torch.nan)}),
        ("viewmats_rs", "m and", {"viewmats_rs": FAR}),
        ("viewmats_rs", "180 degrees", {"viewmats_rs": TURNED}),
    ],
)
def test_what_cannot_be_a_shutter_is_named(place: str, match: str, changes: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=match) as caught:
        rasterization(**_rolling(backend="reference") | changes)
    assert caught.value.place == place


def test_the_edges_of_a_near_pole_are_where_each_row_sees_them() -> None:
    """A pole 3 m beside a vehicle at 15 m/s bends by 0.45 m in 30 ms; both edges of each row are within 0.5 px."""
    width, height, focal, radius = 240, 136, 200.0, 0.03
    heights = torch.arange(-2.0, 2.0, 0.01)
    count = len(heights)
    start, end = torch.eye(4), torch.eye(4)
    end[0, 3] = -0.45
    _, alphas, _ = rasterization(
        torch.stack([torch.full((count,), 0.3), heights, torch.full((count,), 3.0)], dim=1),
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count, 3), radius),
        torch.full((count,), 0.2),
        torch.ones(count, 1),
        start[None],
        torch.tensor([[[focal, 0.0, 120.0], [0.0, focal, 68.0], [0.0, 0.0, 1.0]]]),
        width,
        height,
        with_ut=True,
        rolling_shutter=RollingShutterType.ROLLING_TOP_TO_BOTTOM,
        viewmats_rs=end[None],
    )
    image = alphas[0, ..., 0].numpy()
    edges = []
    for row in (0, 40, 90, height - 1):
        covered = np.flatnonzero(image[row] > 0.5)
        left, right = covered[0], covered[-1]
        before = left - 1 + (0.5 - image[row, left - 1]) / (image[row, left] - image[row, left - 1])
        after = right + (image[row, right] - 0.5) / (image[row, right] - image[row, right + 1])
        edges.append((before + 0.5, after + 0.5))
        middle = focal * (0.3 - 0.45 * row / (height - 1)) / 3.0 + 120.0
        half = 0.5 * (edges[0][1] - edges[0][0])
        assert abs(edges[-1][0] - (middle - half)) < 0.5
        assert abs(edges[-1][1] - (middle + half)) < 0.5
    assert edges[0][0] - edges[-1][0] == pytest.approx(30.0, abs=0.5)
