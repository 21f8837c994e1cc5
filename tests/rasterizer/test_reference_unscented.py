"""Lenses against OpenCV, and the unscented transform against its textbook sums."""

import cv2
import numpy as np
import pytest
import torch

from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.reference.unscented import PROJECTIONS, project_unscented
from mirror.errors import UsageError
from tests.rasterizer.lenses import BROWN, FISHEYE
from tests.rasterizer.small import HEIGHT, WIDTH, K, gaussians, project_small


def _points(number: int) -> torch.Tensor:
    return gaussians(number, seed=20)["means"]


def test_brown_conrady_is_opencvs():
    points = _points(100)
    coefficients = (
        *BROWN.radial_coeffs[:2], *BROWN.tangential_coeffs, *BROWN.radial_coeffs[2:], *BROWN.thin_prism_coeffs,
    )  # fmt: skip
    expected, _ = cv2.projectPoints(points.numpy(), np.zeros(3), np.zeros(3), K.numpy(), np.array(coefficients))
    pixels, valid = PROJECTIONS["pinhole"](points, K, WIDTH, HEIGHT, BROWN)
    assert np.abs(pixels.numpy() - expected[:, 0]).max() < 1e-10
    assert valid.all()


def test_fisheye_is_opencvs():
    points = _points(100)
    expected, _ = cv2.fisheye.projectPoints(
        points.numpy()[:, None], np.zeros(3), np.zeros(3), K.numpy(), np.array(FISHEYE.radial_coeffs)
    )
    pixels, valid = PROJECTIONS["fisheye"](points, K, WIDTH, HEIGHT, FISHEYE)
    assert np.abs(pixels.numpy() - expected[:, 0])[valid.numpy()].max() < 1e-10
    assert valid.float().mean() > 0.9


def test_the_transform_is_the_textbooks_weighted_sums():
    means, axes = _points(30), torch.randn(30, 3, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    axes = 0.2 * axes
    for lens in (FISHEYE, BROWN):
        alpha, beta, kappa = 0.1, 2.0, 0.0
        spread = alpha**2 * (3 + kappa)
        points = torch.stack(
            [means, *(means + sign * spread**0.5 * axes[:, :, i] for sign in (1, -1) for i in (0, 1, 2))]
        )
        pixels, _ = PROJECTIONS[lens.model](points, K, WIDTH, HEIGHT, lens)  # (7, N, 2)
        weights = torch.full((7,), 0.5 / spread, dtype=torch.float64)
        weights[0] = (spread - 3) / spread
        mean = torch.einsum("p,pnc->nc", weights, pixels)
        weights[0] += 1 - alpha**2 + beta
        covariance = torch.einsum("p,pnc,pnd->ncd", weights, pixels - mean, pixels - mean)
        got, roots, _ = project_unscented(means, axes, K, WIDTH, HEIGHT, lens)
        assert torch.allclose(got, mean, rtol=0, atol=1e-10)
        assert torch.allclose(roots @ roots.mT, covariance, rtol=1e-9, atol=1e-9)


def test_a_lens_without_distortion_is_nearly_the_pinhole():
    scene = gaussians(40, seed=21)
    scene["scales"] = scene["scales"] * 0.02
    plain, bent = project_small(**scene), project_small(**scene, lens=LensDistortion(model="pinhole"))
    assert torch.equal(plain.ids, bent.ids)
    assert torch.allclose(plain.means2d, bent.means2d, rtol=0, atol=1e-3)
    assert torch.allclose(plain.conics, bent.conics, rtol=1e-3, atol=1e-6)


def test_a_fisheye_ends_where_its_polynomial_turns_back():
    lens = LensDistortion(model="fisheye", radial_coeffs=(-0.3, 0.0, 0.0, 0.0))
    assert lens.max_angle(1.0, 1.0, 100.0, 100.0, 200, 200) == pytest.approx((1 / 0.9) ** 0.5, rel=1e-12)
    assert LensDistortion(model="fisheye").max_angle(50.0, 100.0, 30.0, 40.0, 60, 80) == pytest.approx(1.0, rel=1e-12)


def test_coefficients_that_a_lens_does_not_have_are_refused():
    with pytest.raises(UsageError, match="4 finite numbers for a fisheye"):
        LensDistortion(model="fisheye", radial_coeffs=(0.1,) * 6)
    with pytest.raises(UsageError, match="0 finite numbers for a fisheye"):
        LensDistortion(model="fisheye", tangential_coeffs=(0.1, 0.2))
    with pytest.raises(UsageError, match="6 finite numbers for a pinhole"):
        LensDistortion(model="pinhole", radial_coeffs=(float("nan"),) * 6)
    with pytest.raises(UsageError, match="no lens 'ortho'"):
        LensDistortion(model="ortho")
