"""Marks find the pixels that rounding can flip, and bound what a flip changes."""

import math

import pytest
import torch

from hybridworldsim.rasterizer.presets import ALPHA_MIN
from hybridworldsim.rasterizer.reference import blend
from hybridworldsim.rasterizer.reference.rounding_marks import find_rounding_marks
from tests.rasterizer.small import PRESET, gaussians, project_small

WIDTH, HEIGHT = 160, 120
K = torch.tensor([[140.0, 0.0, 80.0], [0.0, 140.0, 60.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _marks(seen, opacities):
    return find_rounding_marks(seen, opacities, WIDTH, HEIGHT, preset=PRESET, tile_size=16)


def test_unmarked_pixels_stay_where_they_are_when_inputs_are_rounded():
    """Opacities a little smaller, a little larger: an unmarked pixel changes by rounding, a marked one by its jump."""
    scene = gaussians(8000, seed=30)
    scene["opacities"] = scene["opacities"].clamp(max=0.9)
    scene["scales"] = scene["scales"] * 0.15
    seen = project_small(**scene, K=K, width=WIDTH, height=HEIGHT)
    features = torch.rand(len(seen.ids), 3, generator=torch.Generator().manual_seed(31), dtype=torch.float64)
    opacities = scene["opacities"][seen.ids]
    marked, jump = _marks(seen, opacities)
    assert 0.0005 < marked.double().mean() < 0.2
    assert (jump[~marked] == 0.0).all()
    assert (jump[marked] > 0.0).all()

    def render_image(opacities):
        image = blend(seen, features, opacities, WIDTH, HEIGHT, preset=PRESET, tile_size=16, absgrad=False)
        return torch.cat([image.image, image.alpha[..., None]], dim=-1)

    exact, flipped = render_image(opacities), False
    rounding = 1e-5
    for sign in (-1.0, 1.0):
        change = (render_image(opacities * (1.0 + sign * rounding)) - exact).abs().amax(-1)
        assert change[~marked].max() < 5 * rounding
        assert (change <= jump + 5 * rounding).all()
        flipped |= bool(change.max() > 1e-4)
    assert flipped


@pytest.mark.parametrize(("relative", "expected"), [(0.5e-4, True), (-0.5e-4, True), (2e-4, False), (-2e-4, False)])
def test_an_alpha_near_the_cut_is_marked(relative, expected):
    scene = gaussians(1)
    scene["means"] = torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64)
    scene["scales"] = torch.full((1, 3), 0.1, dtype=torch.float64)
    seen = project_small(**{**scene, "opacities": torch.ones(1, dtype=torch.float64)}, K=K, width=WIDTH, height=HEIGHT)
    x = 10.5  # pixels from the mean, which lies on a corner between pixels
    fall = math.exp(-0.5 * float(seen.conics[0, 0]) * (x * x + 0.25))
    marked, jump = _marks(seen, torch.tensor([ALPHA_MIN / fall * (1.0 + relative)], dtype=torch.float64))
    assert bool(marked[60, 90]) is expected
    assert float(jump[60, 90]) == pytest.approx(ALPHA_MIN if expected else 0.0, rel=0.01)


@pytest.mark.parametrize(("relative", "expected"), [(0.5e-3, True), (-0.5e-3, True), (3e-3, False), (-3e-3, False)])
def test_a_light_near_the_stop_is_marked(relative, expected):
    scene = {name: value.expand(3, *value.shape[1:]).clone() for name, value in gaussians(1).items()}
    scene["means"] = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 2.1], [0.0, 0.0, 2.2]], dtype=torch.float64)
    scene["scales"] = torch.full((3, 3), 1000.0, dtype=torch.float64)
    last = 1.0 - 1e-4 * (1.0 + relative) / (0.1 * 0.1)
    opacities = torch.tensor([0.9, 0.9, last], dtype=torch.float64)
    seen = project_small(**{**scene, "opacities": opacities}, K=K, width=WIDTH, height=HEIGHT)
    marked, jump = _marks(seen, opacities)
    assert bool(marked[60, 80]) is expected
    assert float(jump[60, 80]) == pytest.approx(0.01 if expected else 0.0, rel=0.01)


def test_an_empty_scene_has_no_marks():
    seen = project_small(**gaussians(0), K=K, width=WIDTH, height=HEIGHT)
    marked, jump = _marks(seen, torch.zeros(0, dtype=torch.float64))
    assert not marked.any()
    assert jump.max() == 0.0
