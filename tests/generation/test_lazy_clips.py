"""Clips that are read when they are needed, and the weights of their pixels in the loss."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import ClipFiles, clip_path, header_of, headers_of, read_header, write_clip
from hybridworldsim.generation.clips.weights import pixel_weights
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.training.clip_images import ClipImages
from hybridworldsim.generation.training.generator_trainer import mean_of_views
from hybridworldsim.generation.training.windows import ClipWindows
from hybridworldsim.kept_items import KeptItems
from mirror.errors import DatasetError
from tests.generation.clips import make_clip
from tests.generation.trained import CODEC, NETWORK, T


@pytest.fixture
def clips(tmp_path: Path) -> list[Clip]:
    """Three clips of different lengths; the second says what its pixels are worth. They are in `tmp_path` too."""
    made = [make_clip(f"clip-{seed}", seed=seed, frames=T + 2 + seed) for seed in range(3)]
    rng = np.random.default_rng(0)
    shape = made[1].images.shape[:-1]
    cameras = np.tile(made[1].ego_SE3_camera, (len(made[1]), 1, 1, 1))
    cameras[:, 0, 0, 3] += np.arange(len(made[1]))
    made[1] = replace(
        made[1], excluded=rng.random(shape) < 0.2, hidden=rng.integers(0, 256, shape, np.uint8), ego_SE3_view=cameras
    )
    for clip in made:
        write_clip(tmp_path, clip)
    return made


def test_headers_are_those_of_the_clips(clips: list[Clip], tmp_path: Path) -> None:
    names = [clip.clip_id for clip in clips]
    files = ClipFiles(tmp_path, names)
    assert files.headers == headers_of(files) == [header_of(clip) for clip in clips]
    assert [one.is_weighted for one in files.headers] == [False, True, False]
    data = clip_path(tmp_path, names[0]).read_bytes()
    clip_path(tmp_path, names[0]).write_bytes(data[: len(data) // 2])
    with pytest.raises(DatasetError, match="cannot be read"):
        read_header(tmp_path, names[0])


@pytest.mark.parametrize("keep_bytes", [0, 1 << 30])
def test_windows_and_images_do_not_depend_on_what_is_kept(clips: list[Clip], tmp_path: Path, keep_bytes: int) -> None:
    files = ClipFiles(tmp_path, [clip.clip_id for clip in clips], keep_bytes)
    codec = TinyAutoencoder(CODEC)
    lazy = ClipWindows(files, codec, NETWORK, OWN_STYLE, T, keep_bytes=keep_bytes)
    held = ClipWindows(clips, codec, NETWORK, OWN_STYLE, T)
    assert len(lazy) == len(held) == sum(len(clip) - T for clip in clips)
    numbers = [len(lazy) - 1, 0, 3, 0]
    one, other = lazy.batch(numbers), held.batch(numbers)
    for name in ("target", "references", "present", "weight"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=0.0, atol=0.0)
    for name in ("layout", "camera_to_ego", "background"):
        ours, theirs = (getattr(batch.conditions, name) for batch in (one, other))
        torch.testing.assert_close(ours, theirs, rtol=0.0, atol=0.0)
    with pytest.raises(IndexError):
        lazy.batch([len(lazy)])
    images = ClipImages(files)
    flat = [part.reshape(-1, *part.shape[2:]) for clip in clips for part in (clip.images, clip.background)]
    expected = np.concatenate(flat)
    assert len(images) == len(expected)
    np.testing.assert_array_equal(images[np.arange(len(images))], expected)
    np.testing.assert_array_equal(images[3::7], expected[3::7])


def test_the_items_that_were_not_used_for_longest_go_first() -> None:
    kept: KeptItems[str, str] = KeptItems(2)
    for key in "abacabb":
        assert kept.get(key, lambda: key, len) == key  # noqa: B023
    # a, b; c in place of b; b in place of c.
    assert kept.made == 4


def test_a_pixel_counts_by_the_stated_rule(clips: list[Clip]) -> None:
    clip = clips[1]
    assert clip.tracks is not None and clip.excluded is not None and clip.hidden is not None
    weights = pixel_weights(clip)
    assert weights is not None and pixel_weights(clips[0]) is None
    for place in np.ndindex(clip.tracks.shape):
        expected = 1.0 - clip.hidden[place] / 255.0
        if clip.tracks[place] >= 0:
            expected = 1.0
        if clip.excluded[place]:
            expected = 0.0
        assert weights[place] == pytest.approx(expected, abs=1e-6)


def test_a_latent_counts_by_the_mean_of_its_pixels(clips: list[Clip]) -> None:
    windows = ClipWindows(clips, TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    batch = windows.batch([0, len(clips[0]) - T])
    assert batch.weight is not None
    # The first window is of a clip without weights.
    assert (batch.weight[0] == 1.0).all()
    weights, stride = pixel_weights(clips[1]), NETWORK.latent_stride
    assert weights is not None
    for view, row, column in np.ndindex(*batch.weight.shape[2:]):
        rows, columns = (slice(one * stride, (one + 1) * stride) for one in (row, column))
        expected = weights[T, view, rows, columns].mean()
        assert float(batch.weight[1, 0, view, row, column]) == pytest.approx(float(expected), abs=1e-6)
    assert ClipWindows(clips[::2], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T).batch([0]).weight is None


def test_errors_of_latents_that_do_not_count_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    values = rng.random((2, 1, 3, 4, 5, 6))
    weight = rng.integers(0, 2, (2, 1, 3, 5, 6)).astype(float)
    found = mean_of_views(torch.from_numpy(values), torch.from_numpy(weight))
    expected = (values * weight[:, :, :, None]).mean(axis=(3, 4, 5))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)
    changed = values + 9.0 * (weight == 0.0)[:, :, :, None]
    torch.testing.assert_close(mean_of_views(torch.from_numpy(changed), torch.from_numpy(weight)), found)
    np.testing.assert_allclose(
        mean_of_views(torch.from_numpy(values), None).numpy(), values.mean(axis=(3, 4, 5)), atol=1e-12
    )


def test_cameras_of_a_frame_stand_where_they_were_exposed(clips: list[Clip]) -> None:
    """A camera that was exposed elsewhere sees the box elsewhere."""
    windows = ClipWindows(clips, TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    first = len(clips[0]) - T
    forward = windows.batch([first]).conditions.camera_to_ego[0, -1, :, 0, 3]
    np.testing.assert_allclose(forward, clips[1].ego_SE3_camera[:, 0, 3] + (T, 0.0))
    plain = ClipWindows([replace(clips[1], ego_SE3_view=None)], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    moved, still = windows.batch([first]).conditions.layout, plain.batch([0]).conditions.layout
    assert moved is not None and still is not None
    assert not torch.equal(moved[:, :, 0], still[:, :, 0]) and torch.equal(moved[:, :, 1], still[:, :, 1])
