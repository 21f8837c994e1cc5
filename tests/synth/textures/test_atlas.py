"""Tests of grains and images: means, seams, levels, reproducibility across processes and threads."""

import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest

from mirror.synth.textures import atlas as module
from mirror.synth.textures.atlas import Atlas, atlas
from mirror.synth.textures.catalogue import COUNT, PERIOD_M, PLATES, Grain
from mirror.synth.textures.grains import draw_grain
from mirror.synth.textures.images import draw_image


def levels_of(grain: Grain) -> list[np.ndarray]:
    full = atlas()
    first, log = int(full.grain_index[grain, 0]), int(full.grain_index[grain, 1])
    levels = []
    for level in range(log, -1, -1):
        levels.append(full.grains[first : first + 4**level].reshape(2**level, 2**level))
        first += 4**level
    return levels


def levels_of_image(number: int) -> list[np.ndarray]:
    full = atlas()
    wide, high, count = full.image_index[number, :3]
    levels = []
    for level in range(count):
        first, w, h = full.image_index[number, 3 + level], wide >> level, high >> level
        levels.append(full.images[first : first + w * h].reshape(h, w, 3))
    return levels


def test_index_covers_the_texels_without_gap_or_overlap() -> None:
    full = atlas()
    assert len(full.grains) == sum(len(level) ** 2 for grain in Grain for level in levels_of(grain))
    texels = [level.shape[0] * level.shape[1] for number in range(COUNT) for level in levels_of_image(number)]
    starts = [
        full.image_index[number, 3 + level] for number in range(COUNT) for level in range(full.image_index[number, 2])
    ]
    np.testing.assert_array_equal(starts, np.cumsum([0, *texels[:-1]]))
    assert sum(texels) == len(full.images)


@pytest.mark.parametrize("grain", list(Grain))
def test_grains_have_mean_one_on_every_level(grain: Grain) -> None:
    for level in levels_of(grain):
        assert abs(level.mean(dtype=np.float64) - 1.0) < 2e-7
    fine = levels_of(grain)[0]
    assert fine.min() > 0.0 and fine.max() < 5.0
    assert atlas().grain_index[grain, 2] == pytest.approx(len(fine) / PERIOD_M[grain])


@pytest.mark.parametrize("grain", list(Grain))
def test_grains_have_no_seam(grain: Grain) -> None:
    fine = levels_of(grain)[0].astype(np.float64)
    for axis in (0, 1):
        steps = np.abs(np.diff(fine, axis=axis, append=np.take(fine, [0], axis=axis))).mean(axis=1 - axis)
        # The step across the edge is like other steps; joints make some of them large.
        assert steps[-1] < 1.1 * steps[:-1].max()


@pytest.mark.parametrize("grain", list(Grain))
def test_contrast_decreases_from_level_to_level(grain: Grain) -> None:
    spread = [level.std(dtype=np.float64) for level in levels_of(grain)]
    assert all(after <= before + 1e-7 for before, after in pairwise(spread))
    flat = int(atlas().grain_index[grain, 3])
    assert spread[flat] < 0.002 <= spread[flat - 1]
    # The variance within 2 x 2 blocks plus the variance between blocks is the total variance.
    fine = levels_of(grain)[0].astype(np.float64)
    blocks = fine.reshape(len(fine) // 2, 2, len(fine) // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    assert blocks.var(axis=1).mean() + spread[1] ** 2 == pytest.approx(spread[0] ** 2, rel=1e-4)


@pytest.mark.parametrize("number", [0, 27, 41, 57, 75, 92, 103, 125, 133, 141, 160, 200, 443])
def test_image_levels_are_means_in_linear_light(number: int) -> None:
    levels = levels_of_image(number)
    light = (levels[0] / 255.0) ** 2
    np.testing.assert_array_equal(levels[0], draw_image(number))
    for level in levels[1:]:
        h, w = light.shape[0] // 2, light.shape[1] // 2
        light = light[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3).mean(axis=(1, 3))
        # Half a step of the square-root encoding.
        assert np.abs(np.sqrt(light) * 255.0 - level).max() < 0.502


def test_images_are_neither_black_nor_blank() -> None:
    full = atlas()
    for number in range(COUNT):
        fine = levels_of_image(number)[0]
        assert fine.std() > 12, number
        assert 20 < fine.mean() < 235, number
    assert full.images.max() <= 255


def digest(full: Atlas) -> str:
    parts = (full.grains, full.grain_index, full.images, full.image_index)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def test_atlas_is_shared_by_threads_and_equal_across_processes() -> None:
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: atlas(), range(8)))
    assert all(one is found[0] for one in found)
    code = "from tests.synth.textures.test_atlas import atlas, digest; print(digest(atlas()))"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == digest(found[0])


def test_images_do_not_depend_on_the_order_of_drawing() -> None:
    again = [draw_image(number) for number in (443, 103, 0)]
    for number, image in zip((443, 103, 0), again):
        np.testing.assert_array_equal(image, levels_of_image(number)[0])
    np.testing.assert_array_equal(draw_grain(Grain.GRAVEL), levels_of(Grain.GRAVEL)[0])


def test_atlas_is_locked_while_it_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []

    def slow() -> object:
        built.append(1)
        return object()

    monkeypatch.setattr(module, "BUILT", [])
    monkeypatch.setattr(module, "build_atlas", slow)
    with ThreadPoolExecutor(4) as pool:
        found = set(map(id, pool.map(lambda _: module.atlas(), range(16))))
    assert len(found) == 1 and built == [1]
    assert len(PLATES) == 256
