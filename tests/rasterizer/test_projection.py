"""Projection by compiled kernels: against the float64 reference, on any number of threads, of anything finite."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.rasterizer.cpu.projection import project as project_module
from hybridworldsim.rasterizer.cpu.projection.ordered_output import PART
from hybridworldsim.rasterizer.cpu.projection.project import project as compiled
from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference import project as reference
from tests.draws import draws
from tests.rasterizer.projections import Inputs, default_view, distance, gradients, leaves, options, random_gaussians

K = torch.tensor([[700.0, 0.0, 470.0], [0.0, 650.0, 275.0], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 960, 540
MODES = [("gsplat-1.3", False), ("gsplat-1.3", True), ("gsplat-1.5", False), ("gsplat-1.5", True), ("gsplat-1.6", True)]


def through(project: Any, inputs: Inputs, **how: Any) -> ProjectedGaussians:
    means, quats, scales, opacities, viewmat = inputs
    return project(means, quats, scales, opacities, viewmat, K, WIDTH, HEIGHT, **options(**how))


@pytest.mark.parametrize(("preset", "antialiased"), MODES)
@pytest.mark.parametrize("aspect", [1.0, 1000.0])
def test_kernels_give_what_the_reference_gives(preset: str, antialiased: bool, aspect: float) -> None:
    inputs, same = leaves(random_gaussians(3000, aspect=aspect)), leaves(random_gaussians(3000, aspect=aspect))
    ours = through(compiled, inputs, preset=preset, antialiased=antialiased)
    truth = through(reference, same, preset=preset, antialiased=antialiased)
    assert len(truth.ids) > 500
    assert torch.equal(ours.ids, truth.ids)
    assert (ours.radii != truth.radii).sum() == 0
    assert (ours.means2d.double() + ours.means2d_low - truth.means2d).abs().max() < 1e-8
    assert distance(ours.depths[:, None], truth.depths[:, None]) < 1e-7
    assert distance(ours.conics, truth.conics) < 1e-6
    assert distance(ours.factors, truth.factors) < 1e-6
    if antialiased:
        assert distance(ours.compensations[:, None], truth.compensations[:, None]) < 1e-6
    else:
        assert ours.compensations is None
    for mine, true in zip(gradients(ours, inputs), gradients(truth, same)):
        assert mine.dtype == true.dtype
        assert (mine.double() - true).norm() < 1e-6 * true.norm()


def test_spare_lanes_are_not_taken_for_a_run() -> None:
    inputs = random_gaussians(13)
    inputs[0][:] = torch.tensor([30.0, 0.5, 6.0])
    for last in range(1, 13):
        inputs[0][[0, last // 2, last]] = torch.tensor([[1.0, 0.5, 6.0], [1.1, 0.5, 6.0], [1.2, 0.5, 6.0]])
        ours, same = leaves(inputs), leaves(inputs)
        shown, truth = through(compiled, ours), through(reference, same)
        assert torch.equal(shown.means2d, truth.means2d.float())
        for mine, true in zip(gradients(shown, ours), gradients(truth, same)):
            assert (mine.double() - true).norm() <= 1e-6 * true.norm()
        inputs[0][:] = torch.tensor([30.0, 0.5, 6.0])


def test_causes_of_culling_add_up() -> None:
    inputs = random_gaussians(3000)
    inputs[1][::7] = 0.0
    ours, truth = through(compiled, inputs), through(reference, inputs)
    assert sum(ours.counts.values()) + len(ours.ids) == 3000
    assert {cause: ours.counts[cause] for cause in ("near", "far")} == {c: truth.counts[c] for c in ("near", "far")}
    assert 0 < ours.counts["degenerate"] <= truth.counts["degenerate"]
    small = through(compiled, inputs, radius_clip=10.0)
    assert small.counts["radius"] > 0
    assert torch.equal(small.ids, through(reference, inputs, radius_clip=10.0).ids)


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    results = []
    threads = torch.get_num_threads()
    try:
        for number in (1, 2, 5):
            torch.set_num_threads(number)
            inputs = leaves(random_gaussians(3 * PART + 5))
            ours = through(compiled, inputs, antialiased=True)
            tensors = [tensor for tensor in ours if isinstance(tensor, Tensor)]
            results.append([tensor.detach().numpy().tobytes() for tensor in (*tensors, *gradients(ours, inputs))])
    finally:
        torch.set_num_threads(threads)
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("number", [0, 1, 2, 7, 8, 9, PART + 1])
def test_any_number_of_gaussians(number: int) -> None:
    inputs, same = leaves(random_gaussians(number, seed=number)), leaves(random_gaussians(number, seed=number))
    ours, truth = through(compiled, inputs), through(reference, same)
    assert torch.equal(ours.ids, truth.ids)
    for mine, true in zip(gradients(ours, inputs), gradients(truth, same)):
        assert (mine.double() - true).norm() <= 1e-6 * true.norm()


@pytest.mark.parametrize("number", [1, 3, 4])
def test_one_gradient_without_the_others(number: int) -> None:
    for field in ("means2d", "depths", "conics"):
        results = []
        for project in (compiled, reference):
            inputs = leaves((*(t[:number] for t in random_gaussians(5)[:4]), default_view()))
            with torch.no_grad():
                inputs[0].copy_(torch.tensor([1.0, 0.5, 6.0]) + torch.arange(number)[:, None])
            wanted = (*inputs[:3], inputs[4])
            total = getattr(through(project, inputs), field).square().sum()
            results.append(torch.autograd.grad(total, wanted, allow_unused=True, materialize_grads=True))
        for mine, true in zip(*results):
            assert (mine.double() - true).norm() <= 1e-6 * true.norm()


def test_double_precision_inputs_far_from_the_origin() -> None:
    origin = torch.tensor([4.5e6, -1e7, 3.0], dtype=torch.float64)
    means, quats, scales, opacities, viewmat = random_gaussians(2000, dtype=torch.float64)
    moved = viewmat.clone()
    moved[:3, 3] -= viewmat[:3, :3] @ origin
    near = through(compiled, (means, quats, scales, opacities, viewmat))
    far = leaves((means + origin, quats, scales, opacities, moved))
    ours, truth = through(compiled, far), through(reference, far)
    assert torch.equal(ours.ids, truth.ids)
    assert torch.equal(ours.ids, near.ids)
    # a coordinate of 1e7 m has steps of 2e-9 m, which are 1e-6 pixels and more near the camera
    pixels = ours.means2d.double() + ours.means2d_low
    steps = 700.0 * 8e-9 / truth.depths * (1.0 + (truth.means2d.abs() / 700.0).amax(1))
    assert ((pixels - truth.means2d).abs().amax(1) < steps + 1e-8).all()
    for mine, tensor in zip(gradients(ours, far), (*far[:3], far[4])):
        assert mine.dtype == tensor.dtype == torch.float64


def test_what_is_culled_has_no_gradient() -> None:
    inputs = leaves(random_gaussians(1000))
    ours = through(compiled, inputs)
    hidden = torch.ones(1000, dtype=torch.bool)
    hidden[ours.ids] = False
    for gradient in gradients(ours, inputs)[:3]:
        assert (gradient[hidden] == 0.0).all()
        assert gradient[~hidden].abs().sum(1).min() > 0.0


def test_every_row_of_the_gradients_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts write the rows of culled Gaussians between theirs, and the memory that they get is not zero before."""

    def dirty(count: int, dtype: Any) -> Any:
        array = empty_aligned(count, dtype)
        array.fill(float("nan"))
        return array

    monkeypatch.setattr(project_module, "empty_aligned", dirty)
    number = 10 * PART
    inputs = leaves(random_gaussians(number))
    ours = through(compiled, inputs)
    assert len(ours.ids) > 2 * PART
    hidden = torch.ones(number, dtype=torch.bool)
    hidden[ours.ids] = False
    for gradient in gradients(ours, inputs)[:3]:
        assert (gradient[hidden] == 0.0).all() and gradient.isfinite().all()


@pytest.mark.parametrize("project", [compiled, reference])
def test_what_lies_on_a_plane_is_drawn(project: Any) -> None:
    depths = torch.tensor([2.0, 7.0]).repeat_interleave(3) + torch.tensor([-1.0, 0.0, 1.0]).repeat(2) * 2.0**-20
    means = torch.stack([torch.zeros(6), torch.zeros(6), depths], 1)
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(6, 1)
    inputs = (means, quats, torch.full((6, 3), 0.1), torch.full((6,), 0.5), torch.eye(4))
    ours = through(project, inputs, near_plane=2.0, far_plane=7.0)
    assert ours.ids.tolist() == [1, 2, 3, 4]


def sound(inputs: Inputs, **how: Any) -> ProjectedGaussians:
    """Nothing that comes out is not a number, and nothing forward is infinite."""
    inputs = leaves(inputs)
    ours = through(compiled, inputs, **how)
    for field in ("means2d", "means2d_low", "depths", "conics", "factors"):
        assert getattr(ours, field).isfinite().all(), field
    assert (ours.radii > 0).all()
    for gradient in gradients(ours, inputs):
        assert not gradient.isnan().any()
    return ours


@pytest.mark.parametrize(("preset", "antialiased"), MODES)
def test_degenerate_gaussians_are_culled_or_drawn_and_never_nan(preset: str, antialiased: bool) -> None:
    means, quats, scales, opacities, viewmat = random_gaussians(640)
    means[:160:2] = torch.tensor([1.0, 0.5, 6.0])
    quats[1:160:3] = 0.0
    quats[3:160:7] *= 1e-20
    scales[0:160:4] = torch.logspace(-12, 6, 40)[:, None]
    scales[1:160:4] = 0.0
    scales[2:160:4] *= -1.0
    scales[3:160:4, 1] = 0.0
    inverse = torch.linalg.inv(viewmat)
    plane = torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([3.0, 3.0, 0.0])
    means[160:360] = (plane.double() @ inverse[:3, :3].T + inverse[:3, 3]).float()
    opacities[::5], opacities[1::5] = 0.0, 1.0
    ours = sound((means, quats, scales, opacities, viewmat), preset=preset, antialiased=antialiased, near_plane=0.0)
    assert ours.counts["degenerate"] > 0
    assert len(ours.ids) > 50


def test_nothing_is_seen() -> None:
    inputs = leaves(random_gaussians(100))
    ours = through(compiled, inputs, near_plane=1e3, far_plane=1e4)
    assert len(ours.ids) == 0
    assert ours.counts["near"] == 100
    assert all((gradient == 0.0).all() for gradient in gradients(ours, inputs))


numbers = st.floats(-(2.0**100), 2.0**100, width=32)


@settings(max_examples=draws(200), deadline=None)
@given(st.lists(numbers, min_size=10, max_size=10), st.floats(0.0, 1.0, width=32), st.booleans(), st.booleans())
def test_anything_finite_gives_numbers(shape: list[float], opacity: float, antialiased: bool, blurred: bool) -> None:
    gaussian = torch.tensor([shape])
    inputs = (gaussian[:, :3], gaussian[:, 3:7], gaussian[:, 7:], torch.tensor([opacity]), default_view())
    sound(inputs, antialiased=antialiased, eps2d=0.3 if blurred else 0.0, far_plane=1e30)


@pytest.mark.parametrize("exponent", [-45, -38, -31, -30, -29, -23, -19, 0, 19, 30, 38])
@pytest.mark.parametrize("lens", [None, LensDistortion(model="fisheye")])
def test_quaternions_of_any_length_that_counts_are_the_same_rotation(
    exponent: int, lens: LensDistortion | None
) -> None:
    means, quats, scales, opacities, viewmat = random_gaussians(500)
    means[:] = torch.tensor([0.3, 0.2, 4.0])
    units = torch.nn.functional.normalize(quats.double(), dim=1)
    long = (units * 10.0**exponent).float()  # below 1e-38 what is left of a quaternion is a few bits
    counts = long.double().square().sum(1).sqrt() >= 1e-30
    assert counts.all() == (exponent >= -29)
    assert counts.any() == (exponent >= -30)
    drawn = []
    for project in (compiled, reference):
        inputs = leaves((means, long, scales, opacities.clamp_min(0.1), viewmat))
        shape = (*inputs, K, WIDTH, HEIGHT)
        seen = project(*shape, **(options() | {"lens": lens}))
        assert torch.equal(seen.ids, counts.nonzero()[:, 0])
        assert seen.counts["degenerate"] == 500 - len(seen.ids)
        if counts.any():
            same = (means, units, scales.double(), opacities.clamp_min(0.1), viewmat)
            unit = reference(means.double(), *same[1:], K, WIDTH, HEIGHT, **(options() | {"lens": lens}))
            assert distance(seen.conics, unit.conics[counts[unit.ids]]) < 1e-5
        for gradient in gradients(seen, inputs):
            assert gradient.isfinite().all()
        drawn.append(seen)
    assert torch.equal(drawn[0].ids, drawn[1].ids)


@pytest.mark.parametrize(("length", "count"), [(1e-31, 0), (1e-30, 1), (1e149, 1), (1e151, 0), (1e200, 0)])
def test_quaternions_of_float64_have_the_same_limits(length: float, count: int) -> None:
    means, scales = torch.tensor([[0.3, 0.2, 4.0]]).double(), torch.tensor([[0.1, 0.2, 0.3]]).double()
    quats, opacities = torch.tensor([[length, 0.0, 0.0, 0.0]], dtype=torch.float64), torch.ones(1).double()
    for project in (compiled, reference):
        assert len(through(project, (means, quats, scales, opacities, default_view())).ids) == count
