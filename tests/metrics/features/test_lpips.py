"""LPIPS against a re-computation from the definition; with random weights, so that only the computation is tested."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

from mirror.errors import UsageError
from mirror.metrics.features.lpips import load_lpips, lpips, lpips_heads
from mirror.metrics.features.perceptual import ClampWarning, PerceptualDistance, filled
from mirror.metrics.features.st_lpips import load_st_lpips, split_state, st_lpips
from mirror.weights import resolve
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import ResolvedWeights, WeightResolver, file_sha256
from mirror.weights.table import KNOWN
from tests.metrics.networks.references import ALL, distance
from tests.metrics.networks.trunk_states import random_state, trunk


@pytest.fixture(params=["alex", "squeeze"])
def smoke(request):
    return make(request.param)


def make(name, **kwargs):
    network = trunk(name)
    state = random_state(network)
    draw = torch.Generator().manual_seed(3)
    heads = [torch.rand(channels, generator=draw) for channels in network.channels]
    model = PerceptualDistance("smoke", filled(network, state), heads, **kwargs)
    model.reference = (ALL[name], state, heads)
    return model


def images(height=70, width=52, seed=0):
    draw = np.random.default_rng(seed)
    a = draw.random((height, width, 3))
    return a, np.clip(a + 0.1 * draw.standard_normal(a.shape), 0.0, 1.0)


def reference(model, a, b):
    """Maps and value in float64."""
    run, state, heads = model.reference
    both = torch.from_numpy(np.stack([a, b]).astype(np.float64)).permute(0, 3, 1, 2)
    shift, scale = ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450])
    both = (both * 2 - 1 - torch.tensor(shift).double().reshape(3, 1, 1)) / torch.tensor(scale).double().reshape(
        3, 1, 1
    )
    return distance(run({k: v.double() for k, v in state.items()}, both), [head.double() for head in heads])


@pytest.mark.parametrize("name", ["vgg", "st-alex"])
def test_other_nets(name):
    model = make(name)
    a, b = images(48, 32)
    assert model([b], a)[0] == pytest.approx(reference(model, a, b)[1], rel=1e-5)


def test_value(smoke):
    a, b = images()
    assert smoke([b], a)[0] == pytest.approx(reference(smoke, a, b)[1], rel=1e-5)
    bytes_a, bytes_b = ((x * 255).astype(np.uint8) for x in (a, b))
    assert smoke([bytes_b], bytes_a)[0] == pytest.approx(reference(smoke, bytes_a / 255, bytes_b / 255)[1], rel=1e-5)
    assert smoke.compared == 2


def test_masks(smoke):
    a, b = images()
    mask = np.zeros(a.shape[:2], bool)
    mask[10:40, 5:30] = True
    maps, _ = reference(smoke, a, b)
    wide = sum(
        functional.interpolate(m[None, None], mask.shape, mode="bilinear", align_corners=False)[0, 0] for m in maps
    )
    assert smoke([b], a, mask)[0] == pytest.approx(float(wide[torch.from_numpy(mask)].mean()), rel=1e-5)
    filled_value = reference(smoke, a * mask[..., None], b * mask[..., None])[1]
    assert smoke([b], a, mask, "zero-fill")[0] == pytest.approx(filled_value, rel=1e-5)


def test_one_pixel_and_empty_masks(smoke):
    a, b = images()
    mask = np.zeros(a.shape[:2], bool)
    empty = smoke([b, a], a, mask)
    assert all(math.isnan(score) and score.reason for score in empty)
    mask[3, 4] = True
    assert smoke([b], a, mask)[0] > 0.0


def test_many_renders_of_one_truth(smoke):
    a, b = images()
    c = images(seed=7)[1]
    got = smoke([b, a, c], a)
    assert got[1] == 0.0
    assert (smoke.skipped, smoke.compared) == (1, 2)
    assert got[0] == pytest.approx(smoke([b], a)[0], rel=1e-6)
    assert got[2] == pytest.approx(smoke([c], a)[0], rel=1e-6)


def test_symmetry_and_flat_images(smoke):
    a, b = images()
    assert smoke([b], a)[0] == pytest.approx(smoke([a], b)[0], rel=1e-6)
    flat = np.full((40, 40, 3), 0.5, np.float32)
    for value in (0.0, 1.0):
        assert 0.0 <= smoke([np.full_like(flat, value)], flat)[0] < math.inf


def test_values_are_clamped_and_counted(smoke):
    a, b = images()
    over = b.copy()
    over[0, 0] = [1.0000001, 1.5, -0.1]
    with pytest.warns(ClampWarning, match="3 values"):
        got = smoke([over], a)[0]
    assert smoke.clamped == 3
    assert got == pytest.approx(smoke([np.clip(over, 0, 1)], a)[0], rel=1e-6)


def test_errors(smoke):
    a, b = images()
    mask = np.ones(a.shape[:2], bool)
    for call in (
        lambda: smoke([b[:-1]], a),
        lambda: smoke([b[..., :1]], a[..., :1]),
        lambda: smoke([b[:9, :9]], a[:9, :9]),
        lambda: smoke([b.astype(int)], a),
        lambda: smoke([np.where(b == b.max(), np.nan, b)], a),
        lambda: smoke([np.where(b == b.max(), np.inf, b)], a),
        lambda: smoke([b], a, mask[1:]),
        lambda: smoke([b], a, mask.astype(np.uint8)),
        lambda: smoke([b], a, mask, "erode"),
        lambda: lpips(b, a, smoke),
        lambda: st_lpips(b, a, smoke),
    ):
        with pytest.raises(UsageError):
            call()


def test_other_weights_never_carry_the_name():
    network = trunk("alex")
    heads = [torch.ones(c) for c in network.channels]
    unpinned = ResolvedWeights("alexnet", Path("x"), "0" * 64, pinned=False)
    for name in ("lpips-alex", "lpips", "st_lpips-alex"):
        for weights in ((), [unpinned]):
            with pytest.raises(UsageError, match="without its published weights"):
                PerceptualDistance(name, network, heads, weights)
    with pytest.raises(UsageError, match="heads of"):
        PerceptualDistance("smoke", network, heads[:-1])


@pytest.fixture
def published(tmp_path, monkeypatch):
    """Random weights in the published formats; the table knows their hashes, so that loading can be followed."""
    states = {
        "alexnet": random_state(trunk("alex")) | {"classifier.1.weight": torch.zeros(4, 4)},
        "lpips-heads-alex": {
            f"lin{k}.model.1.weight": torch.rand(1, c, 1, 1) for k, c in enumerate((64, 192, 384, 256, 256))
        },
    }
    layers = random_state(trunk("st-alex"))
    bounds = (3, 7, 11, 13, 15)
    states["st-lpips-alex"] = states["lpips-heads-alex"] | {
        f"net.slice{1 + sum(int(k.split('.')[1]) >= b for b in bounds)}.{k.split('.', 1)[1]}": v
        for k, v in layers.items()
    }
    states["st-lpips-alex"]["scaling_layer.shift"] = torch.zeros(1, 3, 1, 1)
    table = dict(KNOWN)
    paths = {}
    for name, state in states.items():
        paths[name] = tmp_path / f"{name}.pth"
        torch.save(state, paths[name])
        table[name] = dataclasses.replace(KNOWN[name], sha256=file_sha256(paths[name]), size=None)
    monkeypatch.setattr(resolve, "KNOWN", table)
    return paths


def test_published_files(published):
    a, b = images()
    network = load_lpips("alex", WeightResolver(published))
    assert network.name == "lpips-alex"
    assert set(network.weights) == {"alexnet", "lpips-heads-alex"}
    assert lpips(b, a, network) > 0.0
    tolerant = load_st_lpips("alex", WeightResolver(published))
    assert tolerant.name == "st_lpips-alex"
    assert st_lpips(b, a, tolerant) > 0.0
    with pytest.raises(UsageError, match="is not LPIPS"):
        lpips(b, a, tolerant)
    with pytest.raises(UsageError):
        load_lpips("resnet")
    with pytest.raises(UsageError):
        load_st_lpips("squeeze")


def test_missing_weights_say_how_to_get_them(tmp_path, monkeypatch):
    for name in ("XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    with pytest.raises(WeightsUnavailableError, match=r"download\.pytorch\.org/models/alexnet-owt-7be5be79\.pth"):
        load_lpips("alex")


@pytest.mark.parametrize(("net", "channels"), [("alex", 64), ("vgg", 64), ("squeeze", 64)])
def test_real_heads(net, channels):
    """The heads that the lpips and torchmetrics wheels carry, where one is installed."""
    from mirror.weights.load import load_state_dict

    try:
        file = WeightResolver().resolve(f"lpips-heads-{net}")
    except WeightsUnavailableError as error:
        pytest.skip(str(error))
    heads = lpips_heads(load_state_dict(file.path), len(trunk(net).channels))
    assert [head.numel() for head in heads] == list(trunk(net).channels)
    assert all(float(head.min()) >= 0.0 for head in heads)
    with pytest.raises(WeightsUnavailableError):
        lpips_heads(load_state_dict(file.path), 3)


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_real_shift_tolerant_weights(net):
    """The published weights, where the stlpips-pytorch wheel is installed: a shift by a pixel counts for little."""
    try:
        network = load_st_lpips(net)
    except WeightsUnavailableError as error:
        pytest.skip(str(error))
    y, x = np.mgrid[:97, :97] / 97.0
    scene = np.stack([np.sin(9 * x + 4 * y * y), np.cos(13 * y), np.sin(21 * x * y)], axis=2) * 0.4 + 0.5
    noisy = np.clip(scene + 0.2 * np.random.default_rng(0).standard_normal(scene.shape), 0, 1)
    shifted, noise = network([scene[:96, 1:], noisy[:96, :96]], scene[:96, :96])
    assert 0.0 < shifted < 0.25 * noise < 0.5


def test_split_state():
    layers, heads = split_state(
        {"net.slice2.4.filt": torch.ones(1), "lin0.model.1.weight": torch.ones(2), "scaling_layer.shift": torch.ones(3)}
    )
    assert list(layers) == ["features.4.filt"]
    assert list(heads) == ["lin0.model.1.weight"]
