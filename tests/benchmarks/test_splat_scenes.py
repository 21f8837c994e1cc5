"""The benchmark's Gaussians: equal on every machine, finite, and visible to their camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.rasterizer import scenes
from benchmarks.rasterizer.scenes import Splats

MAKERS = {"random": scenes.random, "needles": scenes.needles, "street": scenes.street}
DIGESTS = {
    ("random", 1_000): "2104b8aa408e5e58ca87138075fe2be3c87c2fc09dc1a52dd05c00aa8e0951b2",
    ("needles", 1_000): "30afcfceb84343f6686444cd8f0dc4586800e6bae92ad952a6703d8220b29ac8",
    ("street", 1_000): "eaf8bcef531887596d26c60523bb612ab5cc2e69c68f85400efe73b911c54627",
    ("random", 300_000): "da1305b95751ca2940192cd8830a8017c26f70eb5e43772bc6b83aadc43b30a2",
    ("needles", 300_000): "ce1d24246f0d81c8ddc86737438edfc741f9059928e01cb2c730864247adc4ed",
    ("street", 300_000): "b02401133e26cd69df04d370fa49fcbae624c5e9230e794824736ea1f7b27d9f",
}
GARDEN = "95a8381c4cb8278d1c7f4ecb611b5a5752ee06d0be2ba41f34f3f3f04e162abb"


@pytest.mark.parametrize(("name", "count"), DIGESTS)
def test_arrays_match_the_published_figures(name: str, count: int) -> None:
    assert MAKERS[name](count).digest == DIGESTS[name, count]


def test_garden_matches_the_published_figures(real_data: Path) -> None:
    scene = scenes.garden(real_data / "gsplat_garden")
    check(scene)
    assert scene.digest == GARDEN


@pytest.mark.parametrize("make", MAKERS.values())
@pytest.mark.parametrize("count", [1, 7, 3000])
def test_scenes_have_any_requested_count(make, count: int) -> None:
    scene = make(count)
    assert len(scene) == count
    check(scene)


@pytest.mark.parametrize("make", MAKERS.values())
def test_the_camera_sees_most_of_the_scene(make) -> None:
    scene = make(3000)
    inside = scene.means @ scene.viewmat[:3, :3].T + scene.viewmat[:3, 3]
    pixels = inside @ scene.camera_matrix(960, 540).T
    x, y = pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2]
    seen = (pixels[:, 2] > 0.01) & (x > 0) & (x < 960) & (y > 0) & (y < 540)
    assert seen.mean() > 0.6
    assert np.linalg.norm(scene.viewmat[:3, 3]) < 2.0


def test_intrinsics_scale_with_the_image() -> None:
    scene = scenes.street(10)
    small, large = scene.camera_matrix(480, 270), scene.camera_matrix(1920, 1080)
    np.testing.assert_allclose(large[:2], 4 * small[:2])


def test_first_spherical_harmonic_is_the_colour() -> None:
    scene = scenes.random(100)
    coefficients = scene.spherical_harmonics()
    assert coefficients.shape == (100, 16, 3)
    assert coefficients.dtype == np.float32
    np.testing.assert_allclose(scenes.SH_DC * coefficients[:, 0] + 0.5, scene.colors, atol=1e-6)


def check(scene: Splats) -> None:
    arrays = (scene.means, scene.quats, scene.scales, scene.opacities, scene.colors)
    assert [array.shape[1:] for array in arrays] == [(3,), (4,), (3,), (), (3,)]
    assert all(array.dtype == np.float32 and np.isfinite(array).all() for array in arrays)
    assert (scene.scales > 0).all()
    assert ((scene.opacities > 0) & (scene.opacities < 1)).all()
    assert ((scene.colors >= 0) & (scene.colors <= 1)).all()
    assert (np.linalg.norm(scene.quats, axis=1) > 0).all()
    np.testing.assert_allclose(scene.viewmat[:3, :3] @ scene.viewmat[:3, :3].T, np.eye(3), atol=1e-6)
