"""Time and error of Fréchet and kernel distances and of the networks of FID, FVD and LPIPS, for MIRROR and its peers.

Times are the smallest of the main thread. Networks have random weights: times and differences are meaningful, their
values are not. More peers: ``pip install --no-deps lpips torch-fidelity`` (their torchvision cannot be imported beside
a CPU torch; a stand-in replaces it here). The slowest peers run once: scipy's root takes 20 s.
"""

from __future__ import annotations

import copy
import importlib.util
import math
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.metrics.images import library, thread_ms
from benchmarks.report import Peer, Row
from mirror.arrays import Float64
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.kid import kid
from mirror.metrics.features.statistics import FeatureAccumulator

DIMENSION: Final = 2048
# Required times, as a share of the named peer's time where both were measured.
FRECHET_RATIOS: Final = {100: 10.0 / 20_300.0, 2048: 2.6 / 15.6, 10_000: 4.0 / 18.2}
FRECHET_ERRORS: Final = {100: 1e-11, 2048: 1e-11, 10_000: 5e-11}


def rows() -> Iterator[Row]:
    """Yield the rows of this group."""
    for count in FRECHET_RATIOS:
        yield frechet(count)
    yield covariance()
    yield kernel()
    torch = library("torch")
    if torch is None:
        return
    torch.set_num_threads(1)
    torch.manual_seed(0)
    yield from inception(torch)
    for net in ("alex", "squeeze", "vgg"):
        yield perceptual(torch, net)
    yield video(torch)


def features(count: int) -> tuple[Float64, Float64, float]:
    """Draw non-negative features with a power-law spectrum, transport them by a known map, and return the distance."""
    draw = np.random.default_rng(0)
    turn = np.linalg.qr(draw.standard_normal((DIMENSION, DIMENSION)))[0]
    scales = np.arange(1, DIMENSION + 1) ** -0.6
    first = np.maximum(draw.standard_normal((count, DIMENSION)) @ (scales[:, None] * turn) + 0.4, 0.0)
    turn = np.linalg.qr(draw.standard_normal((DIMENSION, DIMENSION)))[0]
    transport = (turn * draw.uniform(0.7, 1.3, DIMENSION)) @ turn.T
    transport = (transport + transport.T) / 2.0
    rest = np.eye(DIMENSION) - transport
    mean = first.mean(axis=0)
    apart, spread = mean @ rest, (first - mean) @ rest
    truth = math.fsum(apart**2) + math.fsum((spread**2).sum(axis=1)) / (count - 1)
    return first, first @ transport, truth


def frechet(count: int) -> Row:
    first, second, truth = features(count)
    peers = []
    linalg = library("scipy.linalg")
    if linalg is not None:
        peers.append(_once("scipy sqrtm (pytorch-fid)", lambda: _by_root(linalg, first, second), truth))
    peers.append(_once("eigvals (torch-fidelity)", lambda: _by_eigenvalues(first, second), truth))
    bar = peers[0].ms * FRECHET_RATIOS[count] if linalg is not None else None
    ms = thread_ms(lambda: frechet_distance(first, second), 9 if count < 1000 else 5)
    error = abs(frechet_distance(first, second).value - truth) / truth
    size = f"n {count}, d {DIMENSION}"
    return Row("Fréchet distance", size, ms, error, tuple(peers), "relative", bar, FRECHET_ERRORS[count])


def _by_root(linalg: Any, first: Float64, second: Float64) -> float:
    """As implemented in pytorch-fid and clean-fid."""
    apart, one, other = _moments(first, second)
    root = linalg.sqrtm(one @ other)
    if not np.isfinite(root).all():
        offset = np.eye(len(one)) * 1e-6
        root = linalg.sqrtm((one + offset) @ (other + offset))
    return float(apart @ apart + np.trace(one) + np.trace(other) - 2.0 * np.trace(root.real))


def _by_eigenvalues(first: Float64, second: Float64) -> float:
    """As implemented in torch-fidelity."""
    apart, one, other = _moments(first, second)
    roots = np.sqrt(np.linalg.eigvals(one @ other).astype(np.complex128)).real.sum()
    return float(apart @ apart + np.trace(one) + np.trace(other) - 2.0 * roots)


def _moments(first: Float64, second: Float64) -> tuple[Float64, Float64, Float64]:
    apart: Float64 = first.mean(axis=0) - second.mean(axis=0)
    return apart, np.cov(first, rowvar=False), np.cov(second, rowvar=False)


def covariance() -> Row:
    """Return the batches of features of unit variance at an offset of a million."""
    values = np.random.default_rng(0).standard_normal((4000, 256)) + 1e6
    batches = np.array_split(values, 40)
    wide = values.astype(np.longdouble)
    wide -= wide.mean(axis=0)
    truth = (wide.T @ wide / (len(values) - 1)).astype(np.float64)

    def ours() -> Float64:
        stream = FeatureAccumulator()
        for batch in batches:
            stream.update(batch)
        return stream.compute().covariance()

    def theirs() -> Float64:
        total, products = np.zeros(256), np.zeros((256, 256))
        for batch in batches:
            total += batch.sum(axis=0)
            products += batch.T @ batch
        mean = total / len(values)
        found: Float64 = (products - len(values) * np.outer(mean, mean)) / (len(values) - 1)
        return found

    peer = Peer("sum of squares (torchmetrics)", thread_ms(theirs), float(abs(theirs() - truth).max()))
    error = float(abs(ours() - truth).max())
    return Row("covariance, streamed", "offset 1e6, d 256", thread_ms(ours), error, (peer,), error_bar=1e-10)


def kernel() -> Row:
    draw = np.random.default_rng(0)
    pair = draw.standard_normal((1000, DIMENSION)), draw.standard_normal((1000, DIMENSION)) + 0.1

    def theirs() -> float:
        """A kernel for every subset, as in torch-fidelity and torchmetrics."""
        choose = np.random.default_rng(0)
        values = []
        for _ in range(100):
            x, y = (side[choose.choice(1000, 500, replace=False)] for side in pair)
            xx, yy, xy = ((u @ v.T / DIMENSION + 1) ** 3 for u, v in ((x, x), (y, y), (x, y)))
            values.append((xx.sum() - np.trace(xx) + yy.sum() - np.trace(yy)) / (500 * 499) - 2 * xy.mean())
        return float(np.mean(values))

    ours = kid(*pair, subset_size=500)
    error = abs(ours.value - theirs())
    peer = Peer("a kernel a subset (torch-fidelity)", thread_ms(theirs, 1))
    ms = thread_ms(lambda: kid(*pair, subset_size=500), 2)
    return Row("kernel distance, 100 subsets of 500", f"n 1000, d {DIMENSION}", ms, error, (peer,), error_bar=1e-12)


def inception(torch: Any) -> Iterator[Row]:
    from mirror.metrics.features.extractor import extract
    from mirror.metrics.features.fid import InceptionFeatures
    from mirror.metrics.networks.inception import FidInception

    plain = FidInception().eval().requires_grad_(False)
    _spread(torch, plain)
    ours = InceptionFeatures(copy.deepcopy(plain), "tf1", name="smoke", batch=8)
    images = np.random.default_rng(0).integers(0, 256, (8, 540, 960, 3), np.uint8)
    prepared = torch.stack([ours.prepare(image) for image in images])
    theirs = _torch_fidelity(torch, plain)
    with torch.inference_mode():
        exact = copy.deepcopy(plain).double()(prepared.double()).numpy()
        scale = float(np.abs(exact).max())

        def row(count: int) -> Row:
            some, tensors = images[:count], torch.from_numpy(images[:count]).permute(0, 3, 1, 2).contiguous()

            def off(found: Any) -> float:
                return float(abs(np.asarray(found) - exact[:count]).max()) / scale

            peers = []
            if theirs is not None:
                ms = thread_ms(lambda: theirs(tensors)) / count
                peers.append(Peer("torch-fidelity", ms, off(theirs(tensors)[0])))
            alone = prepared[:count]
            peers.append(Peer("unfused, resized before", thread_ms(lambda: plain(alone)) / count, off(plain(alone))))
            ms, error = thread_ms(lambda: extract(ours, some)) / count, off(extract(ours, some))
            name = f"FID features (tf1), an image of {count}"
            # Both sides are near the processor's peak: 11.4 GFlop an image.
            return Row(name, "960x540 RGB", ms, error, tuple(peers), "relative", peers[0].ms, 1e-6)

        yield row(1)
        yield row(8)


def perceptual(torch: Any, net: Any) -> Row:
    """Measure a pair of images; the peer is lpips with the same random weights."""
    from mirror.metrics.features.lpips import lpips_trunk
    from mirror.metrics.features.perceptual import PerceptualDistance

    trunk = lpips_trunk(net).eval().requires_grad_(False)
    _spread(torch, trunk)
    heads = [torch.rand(channels) for channels in trunk.channels]
    theirs = _lpips(torch, net, copy.deepcopy(trunk), heads)
    ours = PerceptualDistance("smoke", trunk, heads)
    draw = np.random.default_rng(0)
    truth = draw.random((540, 960, 3), np.float32)
    render = np.clip(truth + 0.1 * draw.standard_normal(truth.shape), 0, 1).astype(np.float32)
    peers, error, bar = [], None, None
    repeats = 1 if net == "vgg" else 3
    ms = thread_ms(lambda: ours([render], truth), repeats)
    if theirs is not None:
        tensors = [torch.from_numpy(image).permute(2, 0, 1)[None] for image in (render, truth)]
        with torch.inference_mode():
            error = abs(float(theirs(*tensors, normalize=True)) - ours([render], truth)[0])
            peers = [Peer("lpips", thread_ms(lambda: theirs(*tensors, normalize=True), repeats))]
        bar = peers[0].ms
    return Row(f"LPIPS's network, {net}", "960x540 RGB", ms, error, tuple(peers), "to lpips", bar, 1e-7)


def video(torch: Any) -> Row:
    from mirror.metrics.networks.i3d import InflatedInception

    network = InflatedInception().eval().requires_grad_(False)
    clip = torch.rand(1, 3, 16, 224, 224)
    with torch.inference_mode():
        ms = thread_ms(lambda: network(clip), 2)
    return Row("FVD's network, a clip", "16x224x224", ms)


def _once(name: str, call: Callable[[], float], truth: float) -> Peer:
    """A slow peer: one call is timed and checked."""
    import time

    start = time.thread_time()
    value = call()
    return Peer(name, (time.thread_time() - start) * 1e3, abs(value - truth) / truth)


def _spread(torch: Any, network: Any) -> None:
    """Random weights that preserve the features' spread through many layers."""
    for module in network.modules():
        if isinstance(module, torch.nn.Conv2d):
            torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 1.5)


def _bare(name: str) -> bool:
    """Import a package without its ``__init__``, which imports torchvision; false if it is not installed."""
    if name in sys.modules:
        return True
    spec = importlib.util.find_spec(name)
    if spec is None:
        print(f"no figures of {name}: pip install --no-deps {name.replace('_', '-')}", file=sys.stderr)
        return False
    package = types.ModuleType(name)
    package.__path__ = list(spec.submodule_search_locations or ())
    sys.modules.setdefault(name, package)
    if "torchvision" not in sys.modules and importlib.util.find_spec("torchvision") is None:
        for absent in ("torchvision", "torchvision.models", "torchvision.transforms"):
            sys.modules.setdefault(absent, types.ModuleType(absent))
        sys.modules["torchvision"].models = sys.modules["torchvision.models"]  # type: ignore[attr-defined]
    return True


def _torch_fidelity(torch: Any, network: Any) -> Any:
    if not _bare("torch_fidelity"):
        return None
    module = library("torch_fidelity.feature_extractor_inceptionv3")
    if module is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "random.pth"
        torch.save(network.state_dict(), path)
        return module.FeatureExtractorInceptionV3("smoke", ["2048"], feature_extractor_weights_path=str(path))


def _lpips(torch: Any, net: str, trunk: Any, heads: Any) -> Any:
    if not _bare("lpips"):
        return None
    package, networks = sys.modules["lpips"], library("lpips.pretrained_networks")
    if networks is None:
        return None
    names = {"alex": "alexnet", "vgg": "vgg16", "squeeze": "squeezenet1_1"}

    def model(**_: object) -> Any:
        return types.SimpleNamespace(features=trunk.features)

    setattr(sys.modules["torchvision"].models, names[net], model)
    package.normalize_tensor = _unit  # type: ignore[attr-defined]
    module = library("lpips.lpips")
    if module is None:
        return None
    network = module.LPIPS(pretrained=False, net=net, verbose=False).requires_grad_(False)
    for layer, head in zip(network.lins, heads):
        layer.model[-1].weight.copy_(head.reshape(1, -1, 1, 1))
    return network


def _unit(features: Any, eps: float = 1e-10) -> Any:
    """A function that lpips defines in the file that is replaced."""
    return features / (features.square().sum(dim=1, keepdim=True).sqrt() + eps)
