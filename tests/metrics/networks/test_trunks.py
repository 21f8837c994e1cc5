"""Trunks against torchvision's published tensor names and sizes, and against bare functional calls."""

import pytest
import torch

from mirror.metrics.features.perceptual import filled
from mirror.metrics.networks.state import load_strictly
from mirror.weights.errors import WeightsUnavailableError
from tests.metrics.networks.references import ALL
from tests.metrics.networks.trunk_states import random_state, trunk

ALEX = {0: (64, 3, 11, 11), 3: (192, 64, 5, 5), 6: (384, 192, 3, 3), 8: (256, 384, 3, 3), 10: (256, 256, 3, 3)}
VGG = {
    number: (outputs, inputs, 3, 3)
    for number, inputs, outputs in zip(
        (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28),
        (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512),
        (64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
    )
}
FIRES = {3: (64, 16, 64), 4: (128, 16, 64), 6: (128, 32, 128), 7: (256, 32, 128)} | {
    9: (256, 48, 192),
    10: (384, 48, 192),
    11: (384, 64, 256),
    12: (512, 64, 256),
}


def torchvision_sizes(name):
    """Every tensor of torchvision's ``features``."""
    sizes = {}
    if name == "squeeze":
        sizes |= {"features.0.weight": (64, 3, 3, 3), "features.0.bias": (64,)}
        for number, (inputs, narrow, wide) in FIRES.items():
            for part, size in (
                ("squeeze", (narrow, inputs, 1, 1)),
                ("expand1x1", (wide, narrow, 1, 1)),
                ("expand3x3", (wide, narrow, 3, 3)),
            ):
                sizes |= {f"features.{number}.{part}.weight": size, f"features.{number}.{part}.bias": size[:1]}
        return sizes
    for number, size in (ALEX if name == "alex" else VGG).items():
        sizes |= {f"features.{number}.weight": size, f"features.{number}.bias": size[:1]}
    return sizes


@pytest.mark.parametrize("name", ["alex", "vgg", "squeeze"])
def test_torchvision_names_and_sizes(name):
    sizes = torchvision_sizes(name)
    state = {key: torch.zeros(size) for key, size in sizes.items()} | {"classifier.6.bias": torch.zeros(1000)}
    network = filled(trunk(name), state, unused=("classifier.",))
    assert {key: tuple(value.shape) for key, value in network.state_dict().items()} == sizes
    assert not network.training
    assert not any(parameter.requires_grad for parameter in network.parameters())


@pytest.mark.parametrize(
    ("name", "height", "width"), [*((name, 32, 41) for name in ALL), ("alex", 53, 37), ("squeeze", 53, 37)]
)
def test_features(name, height, width):
    network = trunk(name)
    state = random_state(network)
    load_strictly(network, state)
    network.double()
    state = {key: value.double() for key, value in state.items()}
    images = torch.randn(1, 3, height, width, generator=torch.Generator().manual_seed(1)).double()
    truth = ALL[name](state, images)
    with torch.inference_mode():
        got = [[] for _ in truth]
        for tap, rows in network.taps(images.contiguous(memory_format=torch.channels_last)):
            got[tap].append(rows.clone())
    for tap, (expected, parts) in enumerate(zip(truth, got)):
        whole = torch.cat(parts, dim=2)
        assert whole.shape == expected.shape
        assert whole.shape[1] == network.channels[tap]
        torch.testing.assert_close(whole, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("height", [33, 38])
def test_bands_change_nothing(height):
    network = trunk("vgg")
    load_strictly(network, random_state(network))
    network.double()
    images = torch.randn(1, 3, height, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    with torch.inference_mode():
        for band in (2, 8, 1000):
            got = [[] for _ in network.ends]
            for tap, rows in network.taps(images, band):
                got[tap].append(rows.clone())
            wholes = [torch.cat(parts, dim=2) for parts in got]
            if band == 2:
                expected = wholes
                assert len(got[0]) > 5
            for whole, other in zip(wholes, expected):
                torch.testing.assert_close(whole, other, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", list(ALL))
def test_the_least_size(name):
    network = trunk(name)
    load_strictly(network, random_state(network))
    least = network.minimum
    with torch.inference_mode():
        for _, rows in network.taps(torch.zeros(1, 3, least, least)):
            assert min(rows.shape) >= 1
        with pytest.raises(RuntimeError):
            list(network.taps(torch.zeros(1, 3, least - 1, least - 1)))


def test_strict_loading():
    network = trunk("alex")
    good = random_state(network)
    for fault, bad in (
        ("is missing", {k: v for k, v in good.items() if k != "features.0.bias"}),
        ("is unknown", good | {"classifier.6.bias": torch.zeros(1000)}),
        ("not \\(64, 3, 11, 11\\)", good | {"features.0.weight": torch.zeros(64, 3, 7, 7)}),
    ):
        with pytest.raises(WeightsUnavailableError, match=fault):
            load_strictly(trunk("alex"), bad)
