"""Laws of exposure, fitted to images alone, against two laws that the fit does not know."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from hybridworldsim.light.exposure_controller import controller_from, fit_controller, light_features
from mirror.arrays import Float32
from mirror.synth.light.condition import Effects
from mirror.synth.light.lighting import LIGHTING
from mirror.synth.render.develop.camera_response import CameraResponse
from mirror.synth.render.develop.exposure import compute_exposure


def drive(seed: int, count: int) -> list[Float32]:
    """Radiance along a street whose mean brightness wanders, with a bright sky and lamps of random size."""
    rng = np.random.default_rng(seed)
    images, level, shade = [], 0.0, rng.normal(0.0, 0.4, (6, 8))
    for _ in range(count):
        level = 0.9 * level + rng.normal(0.0, 0.25)
        shade = 0.8 * shade + rng.normal(0.0, 0.3, shade.shape)
        image = np.kron(np.exp(shade + level), np.ones((10, 10))) * 0.2 * np.exp(rng.normal(0.0, 0.1, (60, 80)))
        image[: int(rng.uniform(10, 30))] *= 3.0
        rows, columns = rng.integers(0, 60, 8), rng.integers(0, 80, 8)
        image[rows, columns] = 12.0
        images.append(np.repeat(image[..., None], 3, axis=2).astype(np.float32))
    return images


def automatic(images: list[Float32]) -> list[float]:
    """The law of the synthetic fleet: the mean of all, with protection of highlights."""
    record = np.zeros(1, LIGHTING)[0]
    record["exposure"], record["middle"] = 0.9, 0.2
    return [compute_exposure(image, record, CameraResponse(), Effects()) for image in images]


def spot(images: list[Float32], lag: float = 0.0) -> list[float]:
    """Another law: the middle of the image, followed with a delay."""
    gains, last = [], None
    for image in images:
        wanted = 0.3 * float(np.exp(np.log(image[20:40, 27:53].mean(axis=2)).mean())) ** -0.6
        last = wanted if last is None else wanted ** (1.0 - lag) * last**lag
        gains.append(last)
    return gains


def median_error(law: Callable[[list[Float32]], list[float]]) -> float:
    """Median error of predicted gains of a drive that was not fitted; images are seen at gain one."""
    train, test = drive(1, 120), drive(2, 60)
    features = np.array([light_features(torch.from_numpy(image)) for image in train])
    controller = fit_controller(features, np.log(law(train)))
    predicted = [np.exp(controller.log_gain(light_features(torch.from_numpy(image)))) for image in test]
    return float(np.median(np.abs(np.array(predicted) / np.array(law(test)) - 1.0)))


def test_the_law_of_the_synthetic_fleet_is_predicted_within_eight_percent() -> None:
    assert median_error(automatic) < 0.08


def test_spot_metering_is_predicted_within_eight_percent() -> None:
    assert median_error(spot) < 0.08


def test_a_lag_is_not_predicted_from_single_images() -> None:
    # The reason that docs state: what came before an image is not in it.
    without, with_lag = median_error(spot), median_error(lambda images: spot(images, lag=0.6))
    assert with_lag > 2.0 * without


def test_a_tenth_of_wrong_gains_hardly_changes_the_law() -> None:
    images = drive(5, 100)
    features, gains = np.array([light_features(torch.from_numpy(image)) for image in images]), np.log(spot(images))
    broken = gains.copy()
    broken[::10] += 3.0
    right, robust = fit_controller(features, gains), fit_controller(features, broken)
    differences = [right.log_gain(row) - robust.log_gain(row) for row in features]
    assert np.median(np.abs(differences)) < 0.02


@pytest.mark.parametrize("count", [0, 1, 11])
def test_few_images_give_their_median(count: int) -> None:
    gains = np.linspace(-0.3, 0.5, count)
    controller = fit_controller(np.random.default_rng(0).normal(size=(count, 5)), gains)
    assert controller.log_gain(np.full(5, 9.0)) == (float(np.median(gains)) if count else 0.0)


def test_predictions_stay_near_the_gains_of_training_and_laws_are_stored() -> None:
    images = drive(5, 40)
    features, gains = np.array([light_features(torch.from_numpy(image)) for image in images]), np.log(spot(images))
    controller = fit_controller(features, gains)
    for wild in (np.full(5, 100.0), np.full(5, -100.0)):
        assert gains.min() - 0.21 < controller.log_gain(wild) < gains.max() + 0.21
    again = controller_from(controller.numbers())
    assert all(again.log_gain(row) == controller.log_gain(row) for row in features)


def test_equal_features_are_no_reason_to_fail() -> None:
    controller = fit_controller(np.ones((30, 5)), np.linspace(0.0, 1.0, 30))
    assert controller.log_gain(np.ones(5)) == pytest.approx(0.5, abs=0.05)
    black = light_features(torch.zeros(9, 16, 3))
    assert np.isfinite(black).all()
