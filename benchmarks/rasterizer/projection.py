"""Measures projection alone, with gsplat's torch projection as peer, the part of gsplat that runs without CUDA."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.rasterizer.views import View
from benchmarks.report import Peer, Row
from hybridworldsim.rasterizer.presets import DEFAULT_PRESET, get_preset

_NEAR, _FAR, _EPS2D = 0.01, 1e10, 0.3


def projection_rows(view: View, repeats: int) -> Iterator[Row]:
    """Yield times of projection and of its gradients; errors, in pixels, of the means of Gaussians that both keep."""
    true = _ours(view, "reference", torch.float64)()
    ours = _ours(view, "cpu", torch.float32)
    forward, backward, means = _timed(ours, repeats)
    error = _means_error(true.ids, true.means2d, ours().ids, means)
    forward_peers: tuple[Peer, ...] = ()
    backward_peers: tuple[Peer, ...] = ()
    if (peer := _gsplat(view)) is not None:
        peer_forward, peer_backward, peer_means = _timed(peer, repeats)
        everything = torch.arange(len(view.scene))
        off = _means_error(true.ids, true.means2d, everything, peer_means)
        forward_peers = (Peer("gsplat's torch projection", peer_forward, off),)
        backward_peers = (Peer("gsplat's torch projection", peer_backward),)
    name = f"projection, {view.scene.name}"
    yield Row(name, view.size, forward, error, forward_peers, "px")
    yield Row(f"{name}, gradients", view.size, backward, None, backward_peers)


def _ours(view: View, backend: str, dtype: torch.dtype) -> Callable[[], Any]:
    tensors = view.tensors(dtype, gradients=True)
    camera = torch.from_numpy(view.scene.camera_matrix(view.width, view.height)).to(dtype)
    project = importlib.import_module(f"hybridworldsim.rasterizer.{backend}").project

    def call() -> Any:
        return project(
            *(tensors[name] for name in ("means", "quats", "scales", "opacities")),
            tensors["viewmats"][0],
            camera,
            view.width,
            view.height,
            eps2d=_EPS2D,
            near_plane=_NEAR,
            far_plane=_FAR,
            radius_clip=0.0,
            preset=get_preset(DEFAULT_PRESET),
            antialiased=False,
            lens=None,
        )

    return call


def _gsplat(view: View) -> Callable[[], Any] | None:
    """The same by gsplat's `_fully_fused_projection`; None if gsplat is not installed."""
    try:
        torch_impl = importlib.import_module("gsplat.cuda._torch_impl")
    except ModuleNotFoundError:
        return None
    tensors = view.tensors(gradients=True)
    camera = torch.from_numpy(view.scene.camera_matrix(view.width, view.height)).float()[None]

    class Named:
        def __init__(self, means2d: Tensor, depths: Tensor, conics: Tensor) -> None:
            self.means2d, self.depths, self.conics = means2d, depths, conics

    def call() -> Named:
        covars, _ = torch_impl._quat_scale_to_covar_preci(tensors["quats"], tensors["scales"], True, False)
        _, means2d, depths, conics, _ = torch_impl._fully_fused_projection(
            tensors["means"], covars, tensors["viewmats"], camera, view.width, view.height, _EPS2D, _NEAR, _FAR
        )
        return Named(means2d[0], depths[0], conics[0])

    return call


def _timed(call: Callable[[], Any], repeats: int) -> tuple[float, float, Tensor]:
    """Median milliseconds of projection and of the gradients of all its outputs; the projected means."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        done = call()
        middle = time.perf_counter()
        given = [done.means2d, done.depths, done.conics]
        torch.autograd.backward(given, [torch.ones_like(one) for one in given])
        times.append((middle - start, time.perf_counter() - middle))
    forward, backward = np.median(np.array(times[1:]) * 1e3, axis=0)
    return float(forward), float(backward), done.means2d.detach()


def _means_error(true_ids: Tensor, true: Tensor, ids: Tensor, means: Tensor) -> float:
    """Largest difference of means within 10,000 pixels of the origin."""
    common, of_true, of_ours = np.intersect1d(true_ids.numpy(), ids.numpy(), return_indices=True)
    expected = true.detach()[torch.from_numpy(of_true)]
    near = expected.abs().amax(-1) < 1e4
    distance = (means[torch.from_numpy(of_ours)].double() - expected).abs()[near]
    return float(distance.max()) if len(common) else 0.0
