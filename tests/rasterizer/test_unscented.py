"""Gaussians through a lens by compiled kernels: against the float64 reference."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from hybridworldsim.rasterizer.cpu.projection.project import project as compiled
from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference import project as reference
from tests.rasterizer.projections import Inputs, distance, gradients, leaves, options, random_gaussians
from tests.rasterizer.unscented_cameras import HEIGHT, LENSES, WIDTH, K


def through(project: Any, inputs: Inputs, lens: LensDistortion, **how: Any) -> ProjectedGaussians:
    means, quats, scales, opacities, viewmat = inputs
    shape = (means, quats, scales, opacities, viewmat, K, WIDTH, HEIGHT)
    return project(*shape, **(options(**how) | {"lens": lens}))


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("aspect", [1.0, 30.0])
def test_kernels_give_what_the_reference_gives(name: str, aspect: float) -> None:
    inputs, same = leaves(random_gaussians(3000, aspect=aspect)), leaves(random_gaussians(3000, aspect=aspect))
    ours, truth = through(compiled, inputs, LENSES[name]), through(reference, same, LENSES[name])
    assert len(truth.ids) > 300
    assert torch.equal(ours.ids, truth.ids)
    assert (ours.radii != truth.radii).sum() == 0
    assert (ours.means2d.double() + ours.means2d_low - truth.means2d).abs().max() < 1e-8
    assert distance(ours.depths[:, None], truth.depths[:, None]) < 1e-7
    assert distance(ours.conics, truth.conics) < 1e-6
    assert distance(ours.factors, truth.factors) < 1e-6
    assert sum(ours.counts.values()) + len(ours.ids) == 3000
    for mine, true in zip(gradients(ours, inputs), gradients(truth, same)):
        assert mine.dtype == true.dtype
        assert (mine.double() - true).norm() < 1e-6 * true.norm()


def test_a_lens_that_bends_nothing_is_the_limit_of_a_pinhole() -> None:
    inputs = random_gaussians(3000)
    small = (*inputs[:2], 1e-3 * inputs[2], *inputs[3:])
    means, quats, scales, opacities, viewmat = small
    shape = (means, quats, scales, opacities, viewmat, K, WIDTH, HEIGHT)
    bent, straight = through(compiled, small, LENSES["plain"]), compiled(*shape, **options())
    assert torch.equal(bent.ids, straight.ids)
    assert (bent.means2d - straight.means2d).abs().max() < 1e-3
    assert distance(bent.conics, straight.conics.double()) < 1e-4


@pytest.mark.parametrize("name", ["everything", "fisheye"])
def test_points_on_the_axis_beside_it_and_behind_the_camera(name: str) -> None:
    inputs = leaves(random_gaussians(400))
    with torch.no_grad():
        inputs[4].copy_(torch.eye(4))
        inputs[0][:100] *= torch.tensor([0.0, 0.0, 1.0])
        inputs[0][100:200] *= torch.tensor([1e-12, 1e-12, 1.0])
        inputs[0][200:300, 2] = 0.02 * torch.arange(-50, 50)
        inputs[2][350:] = torch.logspace(-12, 6, 50)[:, None]
    same = leaves(inputs)
    ours, truth = through(compiled, inputs, LENSES[name]), through(reference, same, LENSES[name])
    assert torch.equal(ours.ids, truth.ids)
    given = gradients(ours, inputs)
    for mine, true in zip(given, gradients(truth, same)):
        assert not mine.isnan().any()
        assert not true.isnan().any()
        assert (mine.double() - true).norm() < 1e-4 * true.norm()
    for field in (ours.means2d, ours.means2d_low, ours.conics, ours.factors, ours.depths):
        assert field.isfinite().all()


@pytest.mark.parametrize("name", ["everything", "fisheye"])
def test_quaternions_of_zero_and_extreme_shapes_are_no_nan(name: str) -> None:
    inputs = leaves(random_gaussians(400))
    with torch.no_grad():
        inputs[1][:100] = 0.0
        inputs[2][100:200] = torch.logspace(-30, 30, 100)[:, None]
        inputs[0][200:300] *= torch.logspace(-30, 30, 100)[:, None]
        inputs[2][300:350] = 0.0
    ours = through(compiled, inputs, LENSES[name], near_plane=0.0, far_plane=1e35)
    assert ours.ids.min() >= 100
    assert ours.counts["degenerate"] > 0
    for field in (ours.means2d, ours.means2d_low, ours.conics, ours.factors, ours.depths):
        assert field.isfinite().all()
    for gradient in gradients(ours, inputs):
        assert not gradient.isnan().any()


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    threads = torch.get_num_threads()
    results: list[list[bytes]] = []
    try:
        for number in (1, 3):
            torch.set_num_threads(number)
            inputs = leaves(random_gaussians(40_000))
            ours = through(compiled, inputs, LENSES["fisheye"])
            tensors = [tensor for tensor in ours if isinstance(tensor, Tensor)]
            results.append([tensor.detach().numpy().tobytes() for tensor in (*tensors, *gradients(ours, inputs))])
    finally:
        torch.set_num_threads(threads)
    assert results[0] == results[1]


@pytest.mark.parametrize("project", [compiled, reference])
def test_a_fisheye_shows_what_is_less_than_90_degrees_off_its_axis(project: Any) -> None:
    focal, size = 200.0, 800  # an equidistant lens, whose image reaches 114 degrees
    degrees = torch.tensor([0.0, 45.0, 80.0, 89.0, 89.8, 89.95, 90.0, 90.5, 100.0, 114.0, 170.0], dtype=torch.float64)
    angle = degrees.deg2rad()
    means = 5.0 * torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], dim=1)
    shape = (torch.tensor([[1.0, 0.0, 0.0, 0.0]]).double().expand(11, 4), torch.full((11, 3), 1e-3).double())
    intrinsics = torch.tensor([[focal, 0.0, size / 2], [0.0, focal, size / 2], [0.0, 0.0, 1.0]])
    camera = (torch.ones(11).double(), torch.eye(4).double(), intrinsics, size, size)
    seen = project(means, *shape, *camera, **(options() | {"lens": LENSES["equidistant"]}))
    # z is above the near plane of a centimetre up to 89.885 degrees
    assert degrees[seen.ids].tolist() == [0.0, 45.0, 80.0, 89.0, 89.8]
    assert seen.counts["near"] == 6
    torch.testing.assert_close(seen.means2d[:, 0].double(), size / 2 + focal * angle[:5], rtol=0, atol=1e-2)

    # 1 + 3 k1 angle^2 is 0 at 74 degrees: what lies beyond turns back
    turning = LensDistortion(model="fisheye", radial_coeffs=(-0.2, 0.0, 0.0, 0.0))
    seen = project(means, *shape, *camera, **(options() | {"lens": turning}))
    assert degrees[seen.ids].tolist() == [0.0, 45.0]
    assert (seen.counts["near"], seen.counts["frustum"]) == (6, 3)
