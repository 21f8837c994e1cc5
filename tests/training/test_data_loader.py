"""Resampled depth maps of any lens, and the limit of the image cache."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hybridworldsim.training.data_loader import TrainingImageCache, resample_depth, stream_images
from hybridworldsim.training.views import training_views
from mirror.dataset import Dataset
from mirror.geometry.cameras import Camera
from mirror.protocols.document import load_protocol
from tests.baselines.conftest import dataset  # noqa: F401 - a fixture
from tests.training.shadow import DEVICE, WAITS, OnShadows
from tests.training.street import view


def test_image_cache_stays_within_its_byte_limit(dataset: Dataset) -> None:  # noqa: F811
    training = training_views(dataset, load_protocol("static-reconstruction"), "novel", "street")
    views = training.views
    cache = TrainingImageCache(dataset, training.plan, np.zeros(3))
    shown = cache(views[0])
    image_bytes = cache.held_bytes
    assert shown.rgb.dtype == torch.float32 and shown.rgb.max() <= 1.0 and image_bytes < 0.5 * shown.bytes
    assert len(views) > 50
    for capacity, opened in ((len(views), len(views)), (7, 2 * len(views)), (0, 2 * len(views))):
        images = TrainingImageCache(dataset, training.plan, np.zeros(3), cache_bytes=capacity * image_bytes)
        for _ in range(2):
            for camera in views:
                shown = images(camera)
                assert images.held_bytes <= max(capacity, 1) * image_bytes and shown.name == camera.path
        assert images.opened == opened
        # The last image is still cached.
        assert torch.equal(images(views[-1]).rgb, shown.rgb) and images.opened == opened


def test_images_wait_on_the_device_within_a_bound(dataset: Dataset) -> None:  # noqa: F811
    """A stand-in for a GPU: the same numbers, copied without waiting, and nothing is read back."""
    training = training_views(dataset, load_protocol("static-reconstruction"), "novel", "street")
    views = training.views[:12]
    here = TrainingImageCache(dataset, training.plan, np.zeros(3))
    image_bytes = here(views[0]).bytes
    there = TrainingImageCache(dataset, training.plan, np.zeros(3), cache_bytes=5 * image_bytes, device=DEVICE)
    with OnShadows():
        WAITS.clear()
        shown = [there(one) for one in views]
        assert not WAITS and all(one.teaches for one in shown) and not WAITS
        assert {one.rgb.device.type for one in shown} == {DEVICE} and there.held_bytes <= 5 * image_bytes
        for one, camera in zip(shown, views, strict=True):
            assert torch.equal(one.rgb.cpu(), here(camera).rgb) and torch.equal(one.scored.cpu(), here(camera).scored)


def test_threads_read_ahead_in_the_order_of_one(dataset: Dataset) -> None:  # noqa: F811
    training = training_views(dataset, load_protocol("static-reconstruction"), "novel", "street")

    def names(workers: int, count: int = 30) -> list[tuple[str, float]]:
        images = TrainingImageCache(dataset, training.plan, np.zeros(3))
        stream = stream_images(images, training.views[:20], 3, 0, workers)
        found = [(one.name, float(one.rgb.sum())) for one, _ in zip(stream, range(count))]
        stream.close()
        return found

    assert names(4) == names(1)


def lens(width: int, height: int, focal: float, cx: float | None = None) -> Camera:
    return Camera("pinhole", width, height, focal, focal, width / 2 if cx is None else cx, height / 2)


def columns_of(camera: Camera) -> np.ndarray:
    """A depth map whose pixels hold the horizontal slope of their ray plus 10."""
    x = (np.arange(camera.width_px) + 0.5 - camera.cx_px) / camera.fx_px
    return np.tile(x + 10.0, (camera.height_px, 1)).astype(np.float32)


@given(st.integers(8, 200), st.integers(8, 120), st.floats(8.0, 80.0), st.floats(-20.0, 20.0))
def test_depth_is_resampled_to_the_rays_of_the_view(width: int, height: int, focal: float, off: float) -> None:
    requested, map_lens = view("s.day.0", 0), lens(width, height, focal, width / 2 + off)
    resampled = resample_depth(requested, map_lens, columns_of(map_lens))
    truth = columns_of(lens(requested.width_px, requested.height_px, requested.fx_px))
    known = resampled > 0.0
    assert np.abs(resampled - truth)[known].max(initial=0.0) <= 0.5 / focal + 1e-3
    # Depth is unknown exactly outside the map's lens.
    x, y = truth[0] - 10.0, (np.arange(requested.height_px) + 0.5 - requested.cy_px) / requested.fy_px
    inside_x = np.abs(x * focal + off) <= width / 2 - 1e-3
    inside_y = np.abs(y * focal) <= height / 2 - 1e-3
    assert known[np.ix_(inside_y, inside_x)].all()
    outside = np.abs(x * focal + off) > width / 2 + 1e-3
    assert not known[:, outside].any()


@pytest.mark.parametrize("times", [1, 2, 3])
def test_finer_depth_maps_are_read_at_pixel_centres(times: int) -> None:
    requested = view("s.day.0", 0)
    fine = lens(requested.width_px * times, requested.height_px * times, requested.fx_px * times)
    depth = np.arange(fine.width_px * fine.height_px, dtype=np.float32).reshape(fine.height_px, fine.width_px) + 1.0
    depth[0, 0] = np.nan
    expected = np.nan_to_num(depth[times // 2 :: times, times // 2 :: times])
    np.testing.assert_array_equal(resample_depth(requested, fine, depth), expected)
