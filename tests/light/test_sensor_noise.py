from __future__ import annotations

import cv2
import numpy as np
import pytest

from hybridworldsim.light.sensor_noise import NoiseSamples, SensorNoise
from mirror.arrays import Float32


def street(seed: int) -> Float32:
    """A smooth image of all values with edges."""
    rng = np.random.default_rng(seed)
    values = cv2.GaussianBlur(rng.uniform(-1.5, 2.5, (120, 200, 3)).astype(np.float32), (0, 0), 9.0)
    values = (values - values.min()) / (values.max() - values.min())
    values[60:90, 40:160] = 0.4
    return values.astype(np.float32)


def noisy(image: Float32, read: float, shot: float, seed: int) -> Float32:
    spread = np.sqrt(read**2 + shot * image)
    levels = np.clip(image + spread * np.random.default_rng(seed).standard_normal(image.shape), 0.0, 1.0)
    return (np.floor(levels * 255.0 + 0.5) / 255.0).astype(np.float32)


@pytest.mark.parametrize(("read", "shot"), [(0.008, 0.0), (0.01, 0.001), (0.02, 0.002)])
def test_noise_of_images_is_measured_at_each_value(read: float, shot: float) -> None:
    samples = NoiseSamples()
    for seed in range(4):
        samples.add(noisy(street(seed), read, shot, seed), np.ones((120, 200), np.bool_))
    noise = samples.fit()
    assert noise is not None
    for value in (0.25, 0.5, 0.75):
        measured = np.interp(value, np.linspace(0.0, 1.0, 17), noise.deviations)
        assert measured == pytest.approx(np.sqrt(read**2 + shot * value), rel=0.15)


def test_an_image_without_noise_gets_hardly_any() -> None:
    samples = NoiseSamples()
    samples.add(np.round(street(0) * 255.0).astype(np.float32) / np.float32(255.0), np.ones((120, 200), np.bool_))
    noise = samples.fit()
    assert noise is not None and max(noise.deviations) < 0.6 / 255.0


def test_added_noise_has_the_stated_deviation_and_repeats() -> None:
    noise = SensorNoise(tuple(np.linspace(0.01, 0.05, 17)))
    grey = np.full((200, 300, 3), 0.5, np.float32)
    image = noise.add(grey, seed=7)
    assert image.std() / 255.0 == pytest.approx(0.03, rel=0.02)
    assert (noise.add(grey, 7) == image).all() and (noise.add(grey, 8) != image).any()
    assert noise.scaled(2.0).add(grey, 7).std() == pytest.approx(2.0 * image.std(), rel=0.03)


def test_images_without_usable_pixels_give_no_noise() -> None:
    samples = NoiseSamples()
    assert samples.fit() is None
    samples.add(street(0), np.zeros((120, 200), np.bool_))
    samples.add(np.zeros((2, 200, 3), np.float32), np.ones((2, 200), np.bool_))
    assert samples.fit() is None and len(NoiseSamples(samples.table())) == 2
