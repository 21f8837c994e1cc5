"""One case for each difference between gsplat's generations."""

import math

import pytest
import torch

from hybridworldsim.rasterizer.presets import ALPHA_MIN, PRESETS, get_preset
from mirror.errors import UsageError
from tests.rasterizer.small import project_small, render_image

OLD, MIDDLE, NEW = (PRESETS[name] for name in ("gsplat-1.3", "gsplat-1.5", "gsplat-1.6"))
SIZE = 64
K = torch.tensor([[64.0, 0.0, 32.0], [0.0, 64.0, 32.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _one(scale: float, opacity: float, z: float = 4.0) -> dict[str, torch.Tensor]:
    return {
        "means": torch.tensor([[0.0, 0.0, z]], dtype=torch.float64),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64),
        "scales": torch.full((1, 3), scale, dtype=torch.float64),
        "opacities": torch.tensor([opacity], dtype=torch.float64),
    }


def _alpha(scene, preset, **options):
    features = torch.ones(1, 1, dtype=torch.float64)
    return render_image(scene, features, preset=preset, K=K, width=SIZE, height=SIZE, **options)[1]


def test_preset_of_an_unknown_name_names_those_there_are():
    with pytest.raises(UsageError, match=r"gsplat-1\.3 or gsplat-1\.5 or gsplat-1\.6"):
        get_preset("gsplat-2")


def test_three_sigma_square_truncates_what_the_ellipse_shows():
    scene = _one(0.33, 0.9)  # sigma of 5.3 pixels: 3 sigma end inside a tile's border at 16, 1/255 lies beyond it
    old, middle, new = (_alpha(scene, preset) for preset in (OLD, MIDDLE, NEW))
    sigma = math.sqrt((0.33 * 16.0) ** 2 + 0.3)
    assert int(project_small(**scene, preset=OLD, K=K, width=SIZE, height=SIZE).radii[0, 0]) == math.ceil(3 * sigma)
    outside = torch.ones(SIZE, SIZE, dtype=torch.bool)
    outside[8:56, 8:56] = False  # tiles of 8 that the square of radius 16 to 17 touches
    cut = _alpha(scene, OLD, tile_size=8)
    assert cut[outside].max() == 0.0
    assert torch.equal(middle, new)
    reach = math.sqrt(2 * math.log(0.9 / ALPHA_MIN)) * sigma
    x = torch.arange(SIZE) + 0.5 - 32.0
    r = torch.hypot(x[None], x[:, None])
    assert torch.equal(middle > 0.0, r <= reach)
    assert old[old > 0.0].numel() <= middle[middle > 0.0].numel()


def test_square_is_rounded_out_to_tiles_as_large_as_asked():
    scene = _one(0.6, 0.9)  # sigma of 9.6 pixels: three of them reach 29, the ellipse 32
    inner, outer = _alpha(scene, OLD, tile_size=1), _alpha(scene, OLD, tile_size=16)
    assert inner[2].max() == 0.0
    assert outer[2].max() > 0.0
    assert torch.equal(outer, _alpha(scene, MIDDLE))


def test_alpha_is_capped_at_999_then_at_99_thousandths():
    scene = _one(1.0, 1.0)
    peaks = [float(_alpha(scene, preset).max()) for preset in (OLD, MIDDLE, NEW)]
    centre = math.exp(-0.5 * 2 * 0.25 / (16.0**2 + 0.3))
    assert peaks == pytest.approx([min(0.999, centre), min(0.999, centre), 0.99], rel=1e-14)


def test_gradient_stops_at_the_cap():
    scene = _one(1.0, 0.995)
    scene["opacities"] = scene["opacities"].requires_grad_()
    gradients = []
    for preset in (MIDDLE, NEW):
        alpha = _alpha(scene, preset)
        gradients.append(float(torch.autograd.grad(alpha[32, 32], scene["opacities"])[0]))
    assert gradients[0] > 0.9
    assert gradients[1] == 0.0


def test_compensation_has_a_floor_since_1_6():
    scene = _one(1e-4, 1.0)  # 1.6 thousandths of a pixel: the blur leaves 8.5e-6 of its opacity
    options = {"K": K, "width": SIZE, "height": SIZE, "antialiased": True}
    assert float(project_small(**scene, preset=OLD, **options).compensations) == pytest.approx(
        (1.6e-3) ** 2 / ((1.6e-3) ** 2 + 0.3), rel=1e-9
    )
    assert project_small(**scene, preset=MIDDLE, **options).counts["opacity"] == 1
    new = project_small(**scene, preset=NEW, **options)
    assert float(new.compensations) == 0.005
    assert new.counts["opacity"] == 0


def test_faint_gaussians_are_culled_since_1_5():
    scene = _one(0.3, 0.9 * ALPHA_MIN)
    options = {"K": K, "width": SIZE, "height": SIZE}
    assert [project_small(**scene, preset=p, **options).counts["opacity"] for p in (OLD, MIDDLE, NEW)] == [0, 1, 1]
    assert all(_alpha(scene, preset).max() == 0.0 for preset in (OLD, MIDDLE, NEW))
