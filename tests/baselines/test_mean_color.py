"""The mean colour of a camera's training images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.dataset import Dataset
from mirror.errors import DatasetError
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.submission.writing import write_submission
from mirror.methods.training_images import list_training_images
from mirror.protocols.document import Protocol
from mirror.protocols.views import plan_views
from mirror_baselines.mean_color import APPEARANCE, MAX_IMAGES, METHOD, mean_colour, render
from tests.builders.lanes import CAMERAS, DRIVES, FRAMES


class Still:
    """An image of noise."""

    opened = 0

    def __init__(self, seed: int, size: tuple[int, int] = (7, 9)) -> None:
        self.pixels = np.random.default_rng(seed).integers(0, 256, (*size, 3)).astype(np.uint8)

    def decode(self) -> np.ndarray:
        Still.opened += 1
        return self.pixels


@pytest.mark.parametrize("count", [1, 2, 17])
def test_mean_of_all_pixels(count: int) -> None:
    images = [Still(seed) for seed in range(count)]
    expected = np.concatenate([one.pixels.reshape(-1, 3) for one in images]).astype(np.float64).mean(axis=0)
    assert mean_colour(images) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("value", [0, 255])
def test_saturated(value: int) -> None:
    one = Still(0)
    one.pixels[:] = value
    assert mean_colour([one]).tolist() == [value] * 3


def test_mean_colour_opens_a_limited_number_of_images() -> None:
    images = [Still(seed, (1, 1)) for seed in range(3 * MAX_IMAGES)]
    Still.opened = 0
    mean_colour(images)
    assert Still.opened == MAX_IMAGES


def test_views_are_one_colour(dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    plan = plan_views(dataset, protocol, "novel")
    # Every training drive has the same number of unscored images.
    expected = np.mean([colour for _, _, _, colour, role in DRIVES if role == "train"], axis=0)
    for _, image in render(dataset, plan):
        assert (image == image[0, 0]).all()
        assert np.abs(image[0, 0] - expected).max() <= 2
    out = tmp_path / "submission"
    write_submission(dataset, plan, render, METHOD, APPEARANCE, out)
    assert check_submission(open_untrusted(out), plan).problems == ()


def test_training_images_exclude_requested_ones(dataset: Dataset, protocol: Protocol) -> None:
    found = list_training_images(dataset, plan_views(dataset, protocol, "novel"))
    assert set(found) == {("street", camera) for camera in CAMERAS}
    # The plan has frames 0, 5, 10 and the last of three training drives.
    for own in found.values():
        assert len(own.images) == len(own.world_SE3_camera) == 3 * (FRAMES - 4)


def test_camera_without_training_images_is_named(dataset: Dataset, protocol: Protocol) -> None:
    plain = protocol.model_dump(mode="json")
    # The plan has all frames, so that no training image is left.
    plain["frames"]["every"] = 1
    plan = plan_views(dataset, Protocol.model_validate(plain), "novel")
    with pytest.raises(DatasetError, match=r"camera front_wide .* scene street"):
        list_training_images(dataset, plan)
