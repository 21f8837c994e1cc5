"""Blending on the CPU, against the reference in float64: images, gradients, threads, what breaks others."""

import sys

import numpy as np
import pytest
import torch

from hybridworldsim.rasterizer import reference
from hybridworldsim.rasterizer.cpu.blending.blend import blend
from hybridworldsim.rasterizer.presets import get_preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.rounding_marks import find_rounding_marks
from mirror.errors import UsageError

PRESET = get_preset("gsplat-1.5")


def projected(count, width, height, *, aspect=1.0, size=0.05, seed=0):
    """As the reference projects them, with what each is blended with."""
    random = torch.Generator().manual_seed(seed)
    depth = 1.0 + 6.0 * torch.rand(count, generator=random, dtype=torch.float64)
    across = 2.2 * torch.rand(count, 2, generator=random, dtype=torch.float64) - 1.1
    means = torch.cat([across * depth[:, None] * torch.tensor([1.0, height / width]), depth[:, None]], dim=1)
    scales = size * torch.exp(0.5 * torch.randn(count, 3, generator=random, dtype=torch.float64))
    scales = scales * torch.tensor([aspect, 1.0, 1.0])
    quats = torch.randn(count, 4, generator=random, dtype=torch.float64)
    opacities = torch.rand(count, generator=random, dtype=torch.float64)
    camera = torch.tensor([[0.5 * width, 0.0, 0.5 * width], [0.0, 0.5 * width, 0.5 * height], [0.0, 0.0, 1.0]]).double()
    seen = reference.project(
        means, quats, scales, opacities, torch.eye(4).double(), camera, width, height, eps2d=0.3, near_plane=0.01,
        far_plane=1e10, radius_clip=0.0, preset=PRESET, antialiased=False, lens=None,
    )  # fmt: skip
    return seen, opacities[seen.ids]


def single(seen):
    """The same for the CPU."""
    means = seen.means2d.detach()
    return seen._replace(
        means2d=means.float(), means2d_low=(means - means.float()).float(), depths=seen.depths.float(),
        conics=seen.conics.detach(), factors=seen.factors,
    )  # fmt: skip


def render(backend, seen, features, opacities, width, height, weights=None, absgrad=False):
    """Image, alpha, and gradients to means, conics, features and opacities; the magnitudes to the means."""
    leaves = [one.detach().clone().requires_grad_() for one in (seen.means2d, seen.conics, features, opacities)]
    seen = seen._replace(means2d=leaves[0], conics=leaves[1])
    done = backend(seen, *leaves[2:], width, height, preset=PRESET, tile_size=16, absgrad=absgrad)
    if weights is None:
        return done, None
    ((done.image * weights[0].to(done.image)).sum() + (done.alpha * weights[1].to(done.alpha)).sum()).backward()
    return done, [leaf.grad for leaf in leaves] + ([leaves[0].absgrad] if absgrad else [])


def both(count, width, height, channels, **shape):
    seen, opacities = projected(count, width, height, **shape)
    random = torch.Generator().manual_seed(9)
    features = torch.rand(len(seen.ids), channels, generator=random, dtype=torch.float64)
    weights = torch.randn(height, width, channels, generator=random), torch.randn(height, width, generator=random)
    true = render(reference.blend, seen, features, opacities, width, height, weights, absgrad=True)
    ours = render(blend, single(seen), features.float(), opacities.float(), width, height, weights, absgrad=True)
    return seen, opacities, true, ours


CASES = {
    "few": {"count": 60, "width": 40, "height": 24, "channels": 3},
    "no multiple of a tile": {"count": 1500, "width": 133, "height": 77, "channels": 4},
    "seven channels": {"count": 1500, "width": 97, "height": 50, "channels": 7},
    "twenty channels": {"count": 300, "width": 50, "height": 40, "channels": 20},
    "one channel": {"count": 300, "width": 50, "height": 40, "channels": 1},
    "one pixel": {"count": 200, "width": 1, "height": 1, "channels": 3},
    "needles": {"count": 1500, "width": 120, "height": 70, "channels": 3, "aspect": 60.0, "size": 0.008},
}


@pytest.mark.parametrize("case", CASES)
def test_images_and_gradients_are_the_reference_s(case):
    arguments = CASES[case]
    seen, opacities, (true, gradients), (ours, found) = both(**arguments)
    marks = find_rounding_marks(
        seen, opacities, arguments["width"], arguments["height"], preset=PRESET, tile_size=16
    ).marked
    bar = 5e-5 if case == "needles" else 2e-5
    for one, other in ((ours.image, true.image), (ours.alpha[..., None], true.alpha[..., None])):
        assert (one - other).abs().amax(dim=-1)[~marks].max() < bar
    if not marks.any():
        for mine, wanted in zip(found, gradients, strict=True):
            assert (mine - wanted).norm() <= (1e-3 if case == "needles" else 2e-5) * wanted.norm()


def test_slices_of_depth_do_not_change_an_image(monkeypatch):
    seen, opacities = projected(3000, 90, 60, size=0.2)
    features = torch.rand(len(opacities), 3)
    weights = torch.randn(60, 90, 3), torch.randn(60, 90)
    results = []
    for least in (1 << 20, 40):
        monkeypatch.setattr(sys.modules[blend.__module__], "LEAST_SLICE", least)
        results.append(render(blend, single(seen), features, opacities.float(), 90, 60, weights, absgrad=True))
    (whole, gradients), (sliced, found) = results
    assert sliced.counts["pairs"] < 0.8 * whole.counts["pairs"]
    assert torch.equal(sliced.image, whole.image)
    assert torch.equal(sliced.alpha, whole.alpha)
    # what is hidden adds zeros to compensated sums, which may round their last bit
    assert all((one - other).norm() <= 1e-7 * other.norm() for one, other in zip(found, gradients, strict=True))


def test_threads_do_not_change_a_bit():
    seen, opacities = projected(60_000, 200, 120, size=0.02)
    features = torch.rand(len(opacities), 5)
    weights = torch.randn(120, 200, 5), torch.randn(120, 200)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            done, gradients = render(blend, single(seen), features, opacities.float(), 200, 120, weights, absgrad=True)
            results.append([done.image, done.alpha, *gradients])
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


def test_what_is_hidden_is_neither_paired_nor_looked_at():
    seen, opacities = projected(70_000, 64, 48, size=0.05)
    counts = render(blend, single(seen), torch.rand(len(opacities), 3), opacities.float(), 64, 48)[0].counts
    assert counts["stopped_tiles"] == 12
    assert counts["processed_pairs"] < 0.1 * len(opacities) * 12
    assert counts["pairs"] < 0.6 * len(opacities) * 12


def test_an_image_or_an_alpha_that_no_loss_reads_has_no_part_in_the_gradients():
    seen, opacities = projected(50, 40, 24)
    features = torch.rand(len(opacities), 3, dtype=torch.float64)
    for pick in (0, 1):
        gradients = []
        for backend, one in ((reference.blend, seen), (blend, single(seen))):
            values = opacities.to(one.means2d.dtype).detach().clone().requires_grad_()
            done = backend(one, features.to(values), values, 40, 24, preset=PRESET, tile_size=16, absgrad=False)
            (done.image, done.alpha)[pick].sum().backward()
            gradients.append(values.grad)
        torch.testing.assert_close(gradients[1].double(), gradients[0], rtol=1e-5, atol=1e-5)


def test_a_hundred_thousand_on_one_pixel():
    count = 100_000
    seen = ProjectedGaussians(
        ids=torch.arange(count), means2d=torch.full((count, 2), 20.5), means2d_low=torch.zeros(count, 2),
        depths=torch.full((count,), 3.0), conics=torch.tensor([[1.0, 0.0, 1.0]]).repeat(count, 1).double(),
        factors=torch.tensor([[1.0, 0.0, 1.0]]).double().repeat(count, 1), compensations=None,
        radii=torch.full((count, 2), 4, dtype=torch.int32), counts={},
    )  # fmt: skip
    opacities = torch.full((count,), 0.005)
    done, gradients = render(
        blend, seen, torch.ones(count, 3), opacities, 40, 40, (torch.ones(40, 40, 3), torch.ones(40, 40))
    )
    # 0.995^n falls to 1e-4 at n = 1837.4; the Gaussian that would cross it is left out
    assert abs(float(done.alpha[20, 20].detach()) - (1.0 - 0.995**1837)) < 2e-6
    assert all(gradient.isfinite().all() for gradient in gradients)
    assert float(gradients[3][:1000].min()) > 0.0
    assert (gradients[3][3000:] == 0.0).all()


def test_a_pixel_is_blended_to_the_cap_and_no_gradient_passes_there():
    seen = ProjectedGaussians(
        ids=torch.arange(1), means2d=torch.full((1, 2), 8.5), means2d_low=torch.zeros(1, 2),
        depths=torch.ones(1), conics=torch.tensor([[0.5, 0.0, 0.5]]).double(),
        factors=torch.tensor([[0.5**0.5, 0.0, 0.5**0.5]]).double(), compensations=None,
        radii=torch.full((1, 2), 6, dtype=torch.int32), counts={},
    )  # fmt: skip
    weights = torch.zeros(16, 16, 1), torch.zeros(16, 16)
    weights[0][8, 8] = 1.0
    done, gradients = render(blend, seen, torch.ones(1, 1), torch.ones(1), 16, 16, weights)
    assert float(done.alpha[8, 8].detach()) == np.float32(0.999)
    assert float(gradients[3]) == 0.0
    assert float(gradients[2]) == np.float32(0.999)


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_to_see_is_an_empty_image(count):
    seen, opacities = projected(count, 30, 20, size=1e-9)
    opacities = opacities * 0.0
    features = torch.ones(len(opacities), 3)
    weights = torch.ones(20, 30, 3), torch.ones(20, 30)
    done, gradients = render(blend, single(seen), features, opacities.float(), 30, 20, weights)
    assert (done.image == 0.0).all()
    assert (done.alpha == 0.0).all()
    assert all((gradient == 0.0).all() for gradient in gradients)


def test_tiles_of_another_size_are_refused():
    seen, opacities = projected(3, 30, 20)
    with pytest.raises(UsageError, match="tile_size"):
        blend(single(seen), torch.ones(3, 3), opacities.float(), 30, 20, preset=PRESET, tile_size=8, absgrad=False)
