"""Time and error of PSNR, colour-corrected PSNR and SSIM, for MIRROR and its peers.

Times are the smallest of the main thread, so that other work on the machine does not count. Errors: for PSNR in dB
against integers or numpy's float64 least squares; for SSIM the largest of the map, against long double. All use the
same uint8 images.
"""

from __future__ import annotations

import importlib.util
import math
import sys
import time
import types
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.report import Peer, Row
from mirror.arrays import AnyArray, UInt8
from mirror.metrics.images.bootstrap import mean_interval
from mirror.metrics.images.colour_correction import psnr_cc
from mirror.metrics.images.psnr import psnr
from mirror.metrics.images.ssim import PRESETS, ssim, ssim_map
from tests.metrics.images.references import corrected_by_lstsq, ellipse, exact_ssim, street

SIZE: Final = "960x540 RGB"
# Required times, as a share of the named peer's time where both were measured.
PSNR_RATIO: Final = 0.15 / 2.99
PSNR_CC_RATIO: Final = 350.0 / 920.0
_FIDELITY: Final = ("feature_extractor_inceptionv3", "helpers", "interpolate_compat_tensorflow")
SSIM64_RATIO, SSIM32_RATIO, MASKED_RATIO = 45.0 / 215.0, 20.0 / 83.0, 3.0 / 62.0


def rows() -> Iterator[Row]:
    """Yield the rows of this group."""
    cv2.setNumThreads(1)
    torch = library("torch")
    if torch is not None:
        torch.set_num_threads(1)
    render, truth = street(540, 960)
    yield from psnr_rows(render, truth)
    yield corrected(render, truth)
    yield from ssim_rows(render, truth)
    yield masked(render, truth)
    yield intervals()


def psnr_rows(render: UInt8, truth: UInt8) -> Iterator[Row]:
    exact = 10 * math.log10(255**2 * render.size / int(((render.astype(np.int64) - truth) ** 2).sum()))
    peers = []
    torch, torchmetrics, skimage = _torch_metrics()
    if torchmetrics is not None:

        def measure() -> float:
            tensors = [torch.from_numpy(image).float() for image in (render, truth)]
            return float(torchmetrics.peak_signal_noise_ratio(*tensors, data_range=255.0))

        peers.append(_peer("torchmetrics, float32", measure, exact))
    bar = peers[0].ms * PSNR_RATIO if peers else None
    if skimage is not None:
        peers.append(_peer("skimage", lambda: skimage.peak_signal_noise_ratio(truth, render), exact))
    ours = thread_ms(lambda: psnr(render, truth), 200)
    error = abs(psnr(render, truth) - exact)
    yield Row("PSNR, uint8", SIZE, ours, error, tuple(peers), "dB", bar=bar, error_bar=1e-12)
    floats = render / 255.0, truth / 255.0
    error = abs(psnr(*floats, data_range=1.0) - exact)
    yield Row("PSNR, float64", SIZE, thread_ms(lambda: psnr(*floats, data_range=1.0)), error, unit="dB")


def corrected(render: UInt8, truth: UInt8) -> Row:
    floats = render / 255.0, truth / 255.0
    exact = corrected_by_lstsq(*floats)[1]
    peers = []
    torch = library("torch")
    if torch is not None:
        for dtype in (torch.float32, torch.float64):
            name = f"torch lstsq, {str(dtype).removeprefix('torch.')}"
            tensors = [torch.from_numpy(image).to(dtype).reshape(-1, 3) for image in floats]
            peers.append(_peer(name, partial(_torch_corrected, torch, *tensors), exact, repeats=1))
    bar = peers[0].ms * PSNR_CC_RATIO if peers else None
    peers.append(Peer("numpy lstsq, float64", thread_ms(lambda: corrected_by_lstsq(*floats), 1)))
    error = abs(psnr_cc(render, truth).db - exact)
    ms = thread_ms(lambda: psnr_cc(render, truth))
    return Row("PSNR after colour correction", SIZE, ms, error, tuple(peers), "dB", bar=bar, error_bar=1e-6)


def ssim_rows(render: UInt8, truth: UInt8) -> Iterator[Row]:
    torch, torchmetrics, skimage = _torch_metrics()
    msssim, piq = library("pytorch_msssim"), _piq()
    gaussian = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}

    def of_skimage(name: str, dtype: npt.DTypeLike, preset: str, **options: Any) -> list[Peer]:
        if skimage is None:
            return []
        given = {"data_range": 255.0, "channel_axis": -1, **options}

        def measure(**more: Any) -> Any:
            return skimage.structural_similarity(render.astype(dtype), truth.astype(dtype), **given, **more)

        error = float(np.nanmax(abs(measure(full=True)[1] - exact_map(preset))))
        return [Peer(name, thread_ms(measure), error)]

    @cache
    def exact_map(preset: str) -> AnyArray:
        return exact_ssim(render, truth, PRESETS[preset], 255)

    def ours(name: str, preset: str, precision: Any, peers: list[Peer], ratio: float | None, error_bar: float) -> Row:
        ms = thread_ms(lambda: ssim(render, truth, preset=preset, precision=precision), 9)
        error = float(np.nanmax(abs(ssim_map(render, truth, preset=preset, precision=precision) - exact_map(preset))))
        bar = peers[0].ms * ratio if peers and ratio is not None else None
        return Row(name, SIZE, ms, error, tuple(peers), "of the map", bar=bar, error_bar=error_bar)

    def tensors() -> list[Any]:
        return [torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255 for image in (render, truth)]

    peers = of_skimage("skimage, float64", np.float64, "gaussian11", **gaussian)
    yield ours("SSIM gaussian11, float64", "gaussian11", "float64", peers, SSIM64_RATIO, 1e-12)
    peers = of_skimage("skimage, float32", np.float32, "gaussian11", **gaussian)
    if msssim is not None:
        peers.append(Peer("pytorch-msssim, float32", thread_ms(lambda: msssim.ssim(*tensors(), data_range=1.0))))
    if piq is not None:
        peers.append(Peer("piq, float32", thread_ms(lambda: piq.ssim(*tensors(), data_range=1.0, downsample=False))))
    yield ours("SSIM gaussian11, float32", "gaussian11", "float32", peers, SSIM32_RATIO, 2e-4)
    peers = of_skimage("skimage, float64", np.float64, "uniform7")
    yield ours("SSIM uniform7, float64", "uniform7", "float64", peers, None, 1e-12)
    peers = []
    if torchmetrics is not None:
        measure = torchmetrics.structural_similarity_index_measure
        full = measure(*tensors(), data_range=1.0, return_full_image=True)[1][0].permute(1, 2, 0).numpy()
        error = float(abs(full - exact_map("torchmetrics")).max())
        peers.append(Peer("torchmetrics, float32", thread_ms(lambda: measure(*tensors(), data_range=1.0)), error))
    yield ours("SSIM torchmetrics, float32", "torchmetrics", "float32", peers, None, 2e-4)
    yield ours("SSIM 3dgs, float32", "3dgs", "float32", [], None, 2e-4)


def masked(render: UInt8, truth: UInt8) -> Row:
    """Return an object of 120 x 70 px; the peer is DriveStudio's method, the complete map and then the mask."""
    mask = ellipse(540, 960, slice(200, 270), slice(300, 420))
    exact = float(exact_ssim(render, truth, PRESETS["gaussian11"], 255)[mask].mean())
    skimage, peers = library("skimage.metrics"), []
    if skimage is not None:
        options = {"data_range": 255.0, "channel_axis": -1, "full": True}

        def whole() -> float:
            pair = render.astype(np.float32), truth.astype(np.float32)
            return float(skimage.structural_similarity(*pair, **options)[1][mask].mean())

        peers.append(Peer("skimage uniform7 float32, whole map", thread_ms(whole)))
    bar = peers[0].ms * MASKED_RATIO if peers else None
    ms, error = thread_ms(lambda: ssim(render, truth, mask=mask), 50), abs(ssim(render, truth, mask=mask) - exact)
    return Row("SSIM of a masked object, float64", "120x70 px", ms, error, tuple(peers), bar=bar, error_bar=1e-12)


def intervals() -> Row:
    scores = np.random.default_rng(0).standard_normal(200)
    stats, peers = library("scipy.stats"), []
    if stats is not None:
        ms = thread_ms(lambda: stats.bootstrap((scores,), np.mean, method="BCa", n_resamples=10_000, rng=0))
        peers.append(Peer("scipy, without blocks", ms))
    ms = thread_ms(lambda: mean_interval(scores, range(200)))
    return Row("BCa interval, 10 000 draws", "200 blocks", ms, peers=tuple(peers))


def thread_ms(call: Callable[[], object], repeats: int = 3) -> float:
    """Return the smallest time of the main thread over some calls, after one that does not count."""
    call()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        call()
        times.append((time.thread_time() - start) * 1e3)
    return min(times)


def _torch_corrected(torch: Any, colours: Any, target: Any) -> float:
    """PSNR after five fits by ``torch.linalg.lstsq``, the solver that MTGS calls."""
    low, high = 0.5 / 255, 1 - 0.5 / 255
    first = (colours >= low) & (colours <= high)
    for _ in range(5):
        products = [colours[:, c : c + 1] * colours[:, c:] for c in range(3)]
        terms = torch.cat([*products, colours, torch.ones_like(colours[:, :1])], dim=1)
        used = first & (colours >= low) & (colours <= high) & (target >= low) & (target <= high)
        warps = [
            torch.linalg.lstsq(terms * used[:, c : c + 1], target[:, c : c + 1] * used[:, c : c + 1], rcond=-1)[0]
            for c in range(3)
        ]
        colours = (terms @ torch.cat(warps, dim=1)).clip(0, 1)
    return -10 * math.log10(float(((colours - target) ** 2).mean()))


def _peer(name: str, call: Callable[[], float], exact: float, repeats: int = 5) -> Peer:
    return Peer(name, thread_ms(call, repeats), abs(call() - exact))


def _torch_metrics() -> tuple[Any, Any, Any]:
    """torch, torchmetrics and skimage.

    Where torch-fidelity is installed, torchmetrics imports it, and it needs torchvision: stub names are sufficient.
    """
    fidelity = ("torch_fidelity", *(f"torch_fidelity.{name}" for name in _FIDELITY))
    stubs = {name: _Stub(name) for name in fidelity if name not in sys.modules}
    sys.modules.update(stubs)
    found = library("torchmetrics.functional.image")
    for name in stubs:
        del sys.modules[name]
    return library("torch"), found, library("skimage.metrics")


@cache
def library(name: str) -> Any:
    """Return a peer's module; None, with a note, where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        print(f"no figures of {name}: {error}", file=sys.stderr)
        return None


class _Stub(types.ModuleType):
    """A module in which every name is a class."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return object


def _piq() -> Any:
    """Import piq's SSIM without the rest of the package, which needs torchvision."""
    spec = importlib.util.find_spec("piq")
    if spec is not None:
        package = types.ModuleType("piq")
        package.__path__ = list(spec.submodule_search_locations or ())
        sys.modules.setdefault("piq", package)
    return library("piq.ssim")
