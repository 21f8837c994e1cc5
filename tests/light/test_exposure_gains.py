from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridworldsim.light.exposure_gains import ExposureGains, estimate_log_gain
from hybridworldsim.light.trained_response import TrainedResponse


@pytest.mark.parametrize("gain", [0.25, 0.7, 1.0, 1.9, 4.0])
def test_the_gain_of_an_image_is_found_despite_noise_saturation_and_other_things(gain: float) -> None:
    random = torch.Generator().manual_seed(4)
    response = TrainedResponse(["front"])
    colours = torch.rand(60, 100, 3, generator=random) ** 1.5
    with torch.no_grad():
        image = response(colours, "front", float(np.log(gain))).clamp(0.0, 1.0)
        image += 0.01 * torch.randn(image.shape, generator=random)
        image[:20, :60] = torch.rand(20, 60, 3, generator=random)  # a fifth of the image shows something else
        image = (image.clamp(0.0, 1.0) * 255).round() / 255
        light, exposed = response.curve.invert(image, 0), response.exposed(colours, "front")
        scored = torch.ones(60, 100, dtype=torch.bool)
        found = estimate_log_gain(image, colours, light, exposed, scored)
    assert found is not None and np.exp(found) == pytest.approx(gain, rel=0.04)


def test_an_image_without_usable_pixels_has_no_estimate() -> None:
    white, scored = torch.ones(20, 20, 3), torch.ones(20, 20, dtype=torch.bool)
    grey = 0.4 * white
    assert estimate_log_gain(white, grey, white, grey, scored) is None
    assert estimate_log_gain(grey, grey, grey, grey, ~scored) is None


def test_gains_of_a_group_have_the_mean_zero_and_converge() -> None:
    true = dict(zip("abcdef", np.random.default_rng(1).normal(0.0, 0.5, 6)))
    mean = sum(true.values()) / len(true)
    gains = ExposureGains()
    for _ in range(12):
        for name, value in true.items():
            gains.update(name, "drive/front", value - mean)
            gains.update(f"other-{name}", "drive/rear", 3.0 * (value - mean))
    for name, value in true.items():
        assert gains.log_gain(name, "drive/front") == pytest.approx(value - mean, abs=1e-2)
    assert sum(gains.log_gain(name, "drive/front") for name in true) == pytest.approx(0.0, abs=1e-12)


def test_impossible_estimates_are_ignored() -> None:
    gains = ExposureGains()
    for wrong in (float("nan"), float("inf"), 30.0):
        gains.update("a", "g", wrong)
    assert len(gains) == 0 and gains.log_gain("a", "g") == 0.0


def test_stored_gains_are_restored() -> None:
    gains, again = ExposureGains(), ExposureGains()
    for number in range(5):
        gains.update(f"traversal ü/{number}.jpg", f"g{number % 2}", 0.1 * number)
    again.restore(gains.state())
    assert [again.log_gain(f"traversal ü/{number}.jpg", f"g{number % 2}") for number in range(5)] == [
        gains.log_gain(f"traversal ü/{number}.jpg", f"g{number % 2}") for number in range(5)
    ]
    empty = ExposureGains()
    empty.restore(ExposureGains().state())
    assert len(empty) == 0
