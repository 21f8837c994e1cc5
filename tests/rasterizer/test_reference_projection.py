"""Projection: gradients by finite differences, closed forms, needles, and inputs that have no ellipse."""

import pytest
import torch

from hybridworldsim.rasterizer.presets import PRESETS
from tests.rasterizer.lenses import BROWN, FISHEYE
from tests.rasterizer.small import WIDTH, K, gaussians, project_small, render_image

TILTED = torch.tensor(
    [[0.96, 0.0, 0.28, 0.1], [0.0, 1.0, 0.0, -0.2], [-0.28, 0.0, 0.96, 0.3], [0.0, 0.0, 0.0, 1.0]], dtype=torch.float64
)


@pytest.mark.parametrize(
    ("lens", "antialiased", "preset"),
    [
        (None, False, "gsplat-1.5"),
        (None, True, "gsplat-1.5"),
        (None, True, "gsplat-1.6"),
        (FISHEYE, False, "gsplat-1.5"),
        (BROWN, False, "gsplat-1.6"),
    ],
    ids=["pinhole", "antialiased", "floored", "fisheye", "brown_conrady"],
)
def test_projection_passes_gradcheck(lens, antialiased, preset):
    scene = gaussians(3, seed=4)
    opacities = scene["opacities"]

    def outputs(means, quats, scales, viewmat, intrinsics):
        seen = project_small(
            means, quats, scales, opacities, viewmat, K=intrinsics, lens=lens, antialiased=antialiased,
            preset=PRESETS[preset],
        )  # fmt: skip
        return tuple(part for part in (seen.means2d, seen.depths, seen.conics, seen.compensations) if part is not None)

    inputs = tuple(scene[name].requires_grad_() for name in ("means", "quats", "scales"))
    assert torch.autograd.gradcheck(outputs, (*inputs, TILTED.clone().requires_grad_(), K.clone().requires_grad_()))


def test_an_ellipse_on_the_axis_has_the_closed_form():
    quat = torch.tensor([[2.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    seen = project_small(
        torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64), quat,
        torch.tensor([[0.2, -0.4, 9.0]], dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64),
    )  # fmt: skip
    assert seen.means2d[0].tolist() == K[:2, 2].tolist()
    expected = [1 / ((0.2 * 9.0) ** 2 + 0.3), 0.0, 1 / ((0.4 * 8.5) ** 2 + 0.3)]
    assert seen.conics[0].tolist() == pytest.approx(expected, rel=1e-14)
    assert (seen.factors[0].square() - torch.tensor(expected, dtype=torch.float64)).abs().max() < 1e-15


def test_factors_are_those_of_the_conic():
    seen = project_small(**gaussians(50, seed=5))
    f11, f12, f22 = seen.factors.unbind(-1)
    assert torch.allclose(torch.stack([f11**2, f11 * f12, f12**2 + f22**2], dim=-1), seen.conics, rtol=1e-12)


def test_a_needle_keeps_its_determinant():
    turn = torch.tensor([[0.9238795325112867, 0.0, 0.0, 0.3826834323650898]], dtype=torch.float64)  # 45 deg about z
    mean, opacity = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64)
    scales = torch.tensor([[1e6, 1e-6, 1e-6]], dtype=torch.float64)
    K = torch.diag(torch.tensor([100.0, 100.0, 1.0], dtype=torch.float64))
    seen = project_small(mean, turn, scales, opacity, K=K, eps2d=0.0)
    f11, _, f22 = seen.factors[0]
    assert float(f11 * f22) == pytest.approx(1 / (1e8 * 1e-4), rel=1e-9)  # 1 / sqrt(det), det = 1e16 * 1e-8


def test_nothing_to_project():
    seen = project_small(**gaussians(0))
    assert seen.ids.shape == (0,)
    assert seen.means2d.shape == (0, 2)
    assert set(seen.counts.values()) == {0}


def test_what_is_culled_is_counted_by_its_first_cause():
    rows = {
        "near": [0.0, 0.0, 0.005],
        "far": [0.0, 0.0, 200.0],
        "degenerate": [0.0, 0.0, 3.0],
        "opacity": [0.0, 0.0, 3.0],
        "radius": [0.0, 0.0, 100.0],
        "frustum": [50.0, 0.0, 3.0],
        "shown": [0.0, 0.0, 3.0],
    }
    means = torch.tensor(list(rows.values()), dtype=torch.float64)
    quats = torch.ones(7, 4, dtype=torch.float64)
    quats[2] = 0.0
    opacities = torch.full((7,), 0.5, dtype=torch.float64)
    opacities[3] = 0.003
    scales = torch.full((7, 3), 0.3, dtype=torch.float64)
    scales[4] = 1e-3
    seen = project_small(means, quats, scales, opacities, far_plane=150.0, radius_clip=2.0)
    assert seen.ids.tolist() == [6]
    assert seen.counts == dict.fromkeys(("near", "far", "degenerate", "opacity", "radius", "frustum"), 1)


def _degenerate_cases():
    yield "zero_quaternion", {"quats": torch.zeros(4)}
    yield "tiny_quaternion", {"quats": torch.full((4,), 1e-30)}
    for name, scale in {"zero": 0.0, "negative": -0.3, "tiny": 1e-12, "huge": 1e6, "beyond_float64": 1e200}.items():
        yield f"{name}_scales", {"scales": torch.full((3,), scale, dtype=torch.float64)}
    yield "flat", {"scales": torch.tensor([0.3, 0.3, 0.0])}
    yield "needle", {"scales": torch.tensor([1e6, 1e-12, 1e-12])}
    yield "on_the_camera_plane", {"means": torch.tensor([0.5, 0.5, 0.0])}
    yield "at_the_camera", {"means": torch.zeros(3)}
    yield "behind", {"means": torch.tensor([0.0, 0.0, -3.0])}
    yield "grazing", {"means": torch.tensor([1e7, 0.0, 1e-9])}
    yield "far_away", {"means": torch.tensor([1e7, 1e7, 1e7])}
    yield "invisible", {"opacities": torch.tensor(0.0)}
    yield "opaque", {"opacities": torch.tensor(1.0)}
    yield "not_a_number", {"means": torch.full((3,), torch.nan)}
    yield "infinite", {"scales": torch.full((3,), torch.inf)}


@pytest.mark.parametrize("lens", [None, FISHEYE, BROWN], ids=["pinhole", "fisheye", "brown_conrady"])
@pytest.mark.parametrize("change", [pytest.param(change, id=name) for name, change in _degenerate_cases()])
def test_no_input_makes_the_image_or_a_gradient_nan(change, lens):
    for preset in PRESETS.values():
        for antialiased in (False, True) if lens is None else (False,):
            scene = gaussians(3, seed=6)
            for field, value in change.items():
                scene[field][1] = value.double()
            scene = {field: value.requires_grad_() for field, value in scene.items()}
            features = torch.ones(3, 2, dtype=torch.float64, requires_grad=True)
            viewmat = torch.eye(4, dtype=torch.float64, requires_grad=True)
            image, alpha, _ = render_image(
                scene, features, preset=preset, antialiased=antialiased, near_plane=0.0, lens=lens,
                viewmat=viewmat,
            )  # fmt: skip
            assert image.isfinite().all()
            assert alpha.isfinite().all()
            (image.square().sum() + alpha.sum()).backward()
            for value in (*scene.values(), features, viewmat):
                assert value.grad.isfinite().all()


def test_a_million_metres_away_from_the_origin_is_the_same_in_float64():
    scene = gaussians(20, seed=7)
    near = project_small(**scene)
    viewmat = torch.eye(4, dtype=torch.float64)
    shift = torch.tensor([1e6, -2e6, 3e6], dtype=torch.float64)
    viewmat[:3, 3] = -shift
    away = project_small(**{**scene, "means": scene["means"] + shift}, viewmat=viewmat)
    assert torch.equal(near.ids, away.ids)
    assert torch.allclose(near.means2d, away.means2d, rtol=0, atol=1e-7)


def test_the_slope_is_held_beside_the_image():
    """The limits are gsplat's: 0.3 of half the field of view beyond each border, by the principal point."""
    beyond = float((WIDTH - K[0, 2]) / K[0, 0] + 0.3 * 0.5 * WIDTH / K[0, 0])
    scene = gaussians(1)
    scene["scales"] = torch.full((1, 3), 0.8, dtype=torch.float64)
    covariances = []
    for slope in (beyond, beyond * 1.5):
        scene["means"] = torch.tensor([[slope * 2.0, 0.0, 2.0]], dtype=torch.float64)
        covariances.append(project_small(**scene).conics)
    assert torch.allclose(*covariances)
