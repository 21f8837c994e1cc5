"""What training is fed with: depth maps of whatever lens, one mask of the sky."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hybridworldsim.training.data_loader import TrainingImageCache, resample_depth
from hybridworldsim.training.views import training_views
from mirror.dataset import Dataset
from mirror.geometry.cameras import Camera
from mirror.protocols.document import load_protocol
from tests.baselines.conftest import dataset  # noqa: F401 - a fixture
from tests.training.street import view


def test_pictures_take_no_more_memory_than_they_may_however_many_there_are(dataset: Dataset) -> None:  # noqa: F811
    training = training_views(dataset, load_protocol("static-reconstruction"), "novel", "street")
    views = training.views
    alone = TrainingImageCache(dataset, training.plan, np.zeros(3))
    shown = alone(views[0])
    own = alone.held_bytes
    assert shown.rgb.dtype == torch.float32 and shown.rgb.max() <= 1.0 and own < 0.5 * shown.bytes
    assert len(views) > 50
    for room, opened in ((len(views), len(views)), (7, 2 * len(views)), (0, 2 * len(views))):
        pictures = TrainingImageCache(dataset, training.plan, np.zeros(3), cache_bytes=room * own)
        for _ in range(2):
            for one in views:
                shown = pictures(one)
                assert pictures.held_bytes <= max(room, 1) * own and shown.name == one.path
        assert pictures.opened == opened
        # Shown last is held.
        assert torch.equal(pictures(views[-1]).rgb, shown.rgb) and pictures.opened == opened


def lens(width: int, height: int, focal: float, cx: float | None = None) -> Camera:
    return Camera("pinhole", width, height, focal, focal, width / 2 if cx is None else cx, height / 2)


def columns_of(one: Camera) -> np.ndarray:
    """A map in which each pixel says how far to the right its ray goes, a metre ahead."""
    across = (np.arange(one.width_px) + 0.5 - one.cx_px) / one.fx_px
    return np.tile(across + 10.0, (one.height_px, 1)).astype(np.float32)


@given(st.integers(8, 200), st.integers(8, 120), st.floats(8.0, 80.0), st.floats(-20.0, 20.0))
def test_rays_are_those_of_the_view_whatever_the_maps_lens(width: int, height: int, focal: float, off: float) -> None:
    asked, map_lens = view("s.day.0", 0), lens(width, height, focal, width / 2 + off)
    found = resample_depth(asked, map_lens, columns_of(map_lens))
    truth = columns_of(lens(asked.width_px, asked.height_px, asked.fx_px))
    known = found > 0.0
    assert np.abs(found - truth)[known].max(initial=0.0) <= 0.5 / focal + 1e-3
    # Unknown is what the map's lens does not see, and that alone.
    across, down = truth[0] - 10.0, (np.arange(asked.height_px) + 0.5 - asked.cy_px) / asked.fy_px
    inside_x = np.abs(across * focal + off) <= width / 2 - 1e-3
    inside_y = np.abs(down * focal) <= height / 2 - 1e-3
    assert known[np.ix_(inside_y, inside_x)].all()
    outside = np.abs(across * focal + off) > width / 2 + 1e-3
    assert not known[:, outside].any()


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_finer_map_of_the_same_field_is_read_at_the_pixels_centres(times: int) -> None:
    asked = view("s.day.0", 0)
    fine = lens(asked.width_px * times, asked.height_px * times, asked.fx_px * times)
    depth = np.arange(fine.width_px * fine.height_px, dtype=np.float32).reshape(fine.height_px, fine.width_px) + 1.0
    depth[0, 0] = np.nan
    expected = np.nan_to_num(depth[times // 2 :: times, times // 2 :: times])
    np.testing.assert_array_equal(resample_depth(asked, fine, depth), expected)
