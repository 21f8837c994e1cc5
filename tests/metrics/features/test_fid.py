import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mirror.errors import UsageError
from mirror.metrics.features.cache import FeatureCache, feature_key
from mirror.metrics.features.extractor import extract, to_bytes
from mirror.metrics.features.fid import InceptionFeatures, fid, fid_of_features, load_inception
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.networks.inception import FidInception
from mirror.metrics.networks.state import load_strictly
from mirror.weights import resolve
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import WeightResolver, file_sha256
from mirror.weights.table import KNOWN
from tests.metrics.networks.inception_states import published_sizes, random_state


@pytest.fixture(scope="module")
def state():
    return random_state(published_sizes())


@pytest.fixture(scope="module")
def smoke(state):
    network = FidInception()
    load_strictly(network, state)
    return InceptionFeatures(network, name="smoke", batch=2)


def images(count, seed=0, size=(40, 60)):
    return np.random.default_rng(seed).integers(0, 256, (count, *size, 3), dtype=np.uint8)


def test_figure(smoke, tmp_path):
    a, b, cache = images(5), images(4, seed=1) // 2, FeatureCache(tmp_path)
    features = extract(smoke, a, cache), extract(smoke, b, cache)
    got = fid(iter(a), iter(b), smoke, cache=cache)
    assert got.value == pytest.approx(frechet_distance(*features).value, rel=1e-6)
    assert (got.name, got.mode, got.frechet.n) == ("smoke", "clean", (5, 4))
    assert got.kernel is not None
    assert got.kernel.n == (5, 4)
    assert "fewer than 2048" in got.warning


def test_identical_sets(smoke, tmp_path):
    a = images(3)
    got = fid(a, a, smoke, cache=FeatureCache(tmp_path))
    assert got.value == 0.0
    assert got.kernel is None


def test_batches_and_sizes_make_no_difference(smoke):
    mixed = [images(1, size=size)[0] for size in ((40, 60), (20, 20), (60, 40))]
    together = extract(smoke, mixed)
    alone = np.concatenate([extract(smoke, [each]) for each in mixed])
    np.testing.assert_allclose(together, alone, atol=1e-4 * np.abs(alone).max())
    assert together.shape == (3, 2048)


def test_floats_are_rounded():
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(to_bytes(levels / 255.0), levels)
    np.testing.assert_array_equal(to_bytes(levels.astype(np.float32) / np.float32(255)), levels)
    assert to_bytes(np.array([0.499 / 255, 0.501 / 255])).tolist() == [0, 1]


def test_cache(smoke, tmp_path):
    cache = FeatureCache(tmp_path / "features")
    a = images(3)
    before = smoke.computed
    first = extract(smoke, a, cache)
    assert (smoke.computed - before, cache.hits, cache.misses) == (3, 0, 3)
    again = extract(smoke, a[::-1], FeatureCache(tmp_path / "features"))
    np.testing.assert_array_equal(again, first[::-1])
    assert smoke.computed - before == 3
    damaged = next((tmp_path / "features").rglob("*.feature"))
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"\0")
    np.testing.assert_allclose(extract(smoke, a, cache), first, atol=1e-4 * np.abs(first).max())
    assert smoke.computed - before == 4


def test_keys_hold_all_that_matters():
    a = images(1)[0]
    keys = {
        feature_key(a, "clean"),
        feature_key(a, "tf1"),
        feature_key(a.reshape(60, 40, 3), "clean"),
        feature_key(a.astype(np.int16), "clean"),
        feature_key(a ^ 1, "clean"),
    }
    assert len(keys) == 5
    assert feature_key(np.asfortranarray(a), "clean") == feature_key(a, "clean")


def test_modes_have_their_own_identity():
    network = SimpleNamespace(fold=lambda: SimpleNamespace(to=lambda device: None))
    assert InceptionFeatures(network, "tf1", name="x").identity != InceptionFeatures(network, name="x").identity


def test_errors(smoke):
    a = images(3)
    for call in (
        lambda: fid(a, a[:1], smoke),
        lambda: fid([], a, smoke),
        lambda: extract(smoke, [a[0, :, :, 0]]),
        lambda: extract(smoke, [a[0].astype(np.int32)]),
        lambda: extract(smoke, [a[0] / 100.0]),
        lambda: extract(smoke, [a[0] * np.nan]),
        lambda: extract(smoke, [a[0][:0]]),
        lambda: InceptionFeatures(None, "bilinear", name="smoke"),
        lambda: InceptionFeatures(None, name="fid"),
    ):
        with pytest.raises(UsageError):
            call()


def test_published_file(state, smoke, tmp_path, monkeypatch):
    path = tmp_path / "inception.pth"
    torch.save(state, path)
    known = dataclasses.replace(KNOWN["inception-fid"], sha256=file_sha256(path), size=None)
    monkeypatch.setattr(resolve, "KNOWN", KNOWN | {"inception-fid": known})
    network = load_inception("clean", WeightResolver({"inception-fid": path}))
    assert network.name == "fid"
    assert network.weights == {"inception-fid": known.sha256}
    a = images(2)
    np.testing.assert_array_equal(extract(network, a), extract(smoke, a))


def test_missing_weights(tmp_path, monkeypatch):
    for name in ("XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    with pytest.raises(WeightsUnavailableError, match="6726825d0af5f729"):
        load_inception()


def test_many_images_warn_no_more(smoke):
    draw = np.random.default_rng(0)
    features = draw.standard_normal((2048, 3)), draw.standard_normal((2050, 3))
    assert fid_of_features(*features, smoke).warning is None
