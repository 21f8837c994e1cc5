"""Blending: gradients by finite differences, a pixel loop as plain as gsplat's, gathered absolute gradients."""

import math

import pytest
import torch

from hybridworldsim.rasterizer.presets import ALPHA_MIN, PRESETS, TRANSMITTANCE_STOP
from hybridworldsim.rasterizer.reference import blend
from tests.rasterizer.small import HEIGHT, PRESET, WIDTH, gaussians, project_small, render_image


def _blend(seen, features, opacities, width=WIDTH, height=HEIGHT, absgrad=False, preset=PRESET, tile_size=16):
    return blend(seen, features, opacities, width, height, preset=preset, tile_size=tile_size, absgrad=absgrad)


def _scalar(seen, features, opacities, width, height, alpha_max):
    """gsplat's loop over the Gaussians of one pixel, in Python floats."""
    order = sorted(range(len(seen.ids)), key=lambda row: (float(seen.depths[row].float()), row))
    image = torch.zeros(height, width, features.shape[1], dtype=torch.float64)
    alpha_image = torch.zeros(height, width, dtype=torch.float64)
    means, conics = seen.means2d.tolist(), seen.conics.tolist()
    for i in range(height):
        for j in range(width):
            light = 1.0
            for row in order:
                x, y = means[row][0] - j - 0.5, means[row][1] - i - 0.5
                a, b, c = conics[row]
                alpha = min(alpha_max, float(opacities[row]) * math.exp(-0.5 * (a * x * x + c * y * y) - b * x * y))
                if alpha < ALPHA_MIN:
                    continue
                if light * (1.0 - alpha) <= TRANSMITTANCE_STOP:
                    break
                image[i, j] += light * alpha * features[row]
                light *= 1.0 - alpha
            alpha_image[i, j] = 1.0 - light
    return image, alpha_image


@pytest.mark.parametrize("tile_size", [4, 16])
@pytest.mark.parametrize("preset", ["gsplat-1.5", "gsplat-1.6"])
def test_blending_is_gsplats_loop(preset, tile_size):
    scene = gaussians(60, seed=8)
    scene["opacities"] = scene["opacities"].clamp(min=0.7) + 0.09  # so that pixels stop
    seen = project_small(**scene, preset=PRESETS[preset])
    opacities = scene["opacities"][seen.ids]
    features = torch.rand(len(seen.ids), 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    got = _blend(seen, features, opacities, preset=PRESETS[preset], tile_size=tile_size)
    image, alpha = _scalar(seen, features, opacities, WIDTH, HEIGHT, PRESETS[preset].alpha_max)
    assert (got.image - image).abs().max() < 1e-13
    assert (got.alpha - alpha).abs().max() < 1e-13
    assert got.alpha.max() > 0.999


def test_more_gaussians_than_a_chunk_holds_blend_the_same():
    scene = gaussians(700, seed=10)
    scene["opacities"] = scene["opacities"] * 0.05
    seen = project_small(**scene)
    opacities, features = scene["opacities"][seen.ids], torch.ones(len(seen.ids), 1, dtype=torch.float64)
    image, _ = _scalar(seen, features, opacities, 5, 4, PRESET.alpha_max)
    got = _blend(seen, features, opacities)
    assert got.counts["processed_pairs"] > 600
    assert (got.image[:4, :5] - image).abs().max() < 1e-13


@pytest.mark.parametrize("antialiased", [False, True])
def test_blending_passes_gradcheck(antialiased):
    scene = gaussians(4, seed=11)
    seen = project_small(**scene, antialiased=antialiased)
    features = torch.rand(len(seen.ids), 2, generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    opacities = scene["opacities"][seen.ids]
    if antialiased:
        opacities = opacities * seen.compensations

    def outputs(means2d, conics, features, opacities):
        got = _blend(seen._replace(means2d=means2d, conics=conics), features, opacities)
        return got.image, got.alpha

    inputs = (seen.means2d, seen.conics, features, opacities)
    assert torch.autograd.gradcheck(outputs, tuple(part.detach().requires_grad_() for part in inputs), fast_mode=True)


def test_the_whole_path_passes_gradcheck():
    scene = gaussians(3, seed=13)
    names = list(scene)

    def outputs(features, *parts):
        image, alpha, _ = render_image(dict(zip(names, parts)), features, antialiased=True)
        return image.sum((0, 1)), alpha.sum()

    features = torch.rand(3, 2, generator=torch.Generator().manual_seed(14), dtype=torch.float64)
    assert torch.autograd.gradcheck(outputs, tuple(part.requires_grad_() for part in (features, *scene.values())))


def test_absolute_gradients_are_the_sum_over_pixels_of_each_pixels():
    scene = gaussians(8, seed=15)
    seen = project_small(**{name: value.requires_grad_() for name, value in scene.items()})
    seen.means2d.retain_grad()
    opacities, features = scene["opacities"].detach()[seen.ids], torch.ones(len(seen.ids), 1, dtype=torch.float64)
    got = _blend(seen, features, opacities, absgrad=True)
    expected = torch.zeros_like(seen.means2d)
    for pixel in got.image.flatten():
        if pixel > 0.0:
            expected += torch.autograd.grad(pixel, seen.means2d, retain_graph=True)[0].abs()
    for _ in range(2):  # twice, because a second backward must not add to the first
        got.image.sum().backward(retain_graph=True)
        assert torch.allclose(seen.means2d.absgrad, expected, rtol=1e-12)


def test_an_empty_image_still_has_a_gradient():
    scene = {name: value.requires_grad_() for name, value in gaussians(0).items()}
    features = torch.zeros(0, 3, dtype=torch.float64, requires_grad=True)
    image, alpha, _ = render_image(scene, features)
    assert image.shape == (HEIGHT, WIDTH, 3)
    (image.sum() + alpha.sum()).backward()
    assert features.grad.shape == (0, 3)
    assert scene["means"].grad.shape == (0, 3)


def test_an_image_of_one_pixel():
    image, alpha, _ = render_image(gaussians(4, seed=16), torch.ones(4, 3, dtype=torch.float64), width=1, height=1)
    assert image.shape == (1, 1, 3)
    assert torch.allclose(image[0, 0], alpha[0, 0].expand(3))


def test_equal_depths_blend_by_index():
    scene = gaussians(2, seed=17)
    scene["means"] = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, 3.0 + 1e-9]], dtype=torch.float64).flip(0)
    features = torch.eye(2, dtype=torch.float64)
    image, _, _ = render_image(scene, features)
    seen = project_small(**scene)
    expected, _ = _scalar(seen, features, scene["opacities"], WIDTH, HEIGHT, PRESET.alpha_max)
    assert torch.allclose(image, expected, rtol=0, atol=1e-14)
    assert image[6, 10, 0] > 0.0


def test_a_thousand_opaque_splats_on_one_pixel_end_it():
    scene = {name: value[:1].expand(1000, *value.shape[1:]).clone() for name, value in gaussians(1).items()}
    scene["opacities"] = torch.ones(1000, dtype=torch.float64, requires_grad=True)
    image, alpha, _ = render_image(scene, torch.ones(1000, 1, dtype=torch.float64))
    assert alpha.max() < 1.0 - TRANSMITTANCE_STOP
    image.sum().backward()
    assert scene["opacities"].grad.isfinite().all()
