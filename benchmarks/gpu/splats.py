"""Checks of what a device computes, the rasterizer beside gsplat called directly, and frames a second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from benchmarks.gpu.machine import HEIGHT_PX, WIDTH_PX, Machine
from benchmarks.gpu.quantities import BUDGETS_S, GAUSSIANS, SIZES
from benchmarks.rasterizer import scenes
from benchmarks.street.benchmark import corridor
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.street import StreetModel
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.cuda import preset_on
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, Viewpoint

SOURCE: Final = Source("s.a.0", "front_wide")
_SHARES: Final = (0.85, 0.12, 0.03)
"""Of background, ground and sky in the Gaussians of a street."""
_STEPS: Final = 200
_NAMES: Final = ("means", "quats", "scales", "opacities", "colors")


def measure_checks(machine: Machine) -> dict[str, float]:
    """Compare the device with the compiled kernels of the CPU: an image, gradients, losses, and a short training."""
    found = {}
    width, height = machine.size_px(240, 135)
    scene = scenes.street(machine.count(50_000, 500))
    one, other = (_image_and_gradients(scene, width, height, device) for device in ("cpu", machine.device))
    if machine.is_gpu:
        found["colours, against the rasterizer of the CPU"] = _farthest(one["image"], other["image"])
        found["gradients, against the rasterizer of the CPU"] = max(
            float((one[name] - other[name]).norm() / one[name].norm()) for name in _NAMES
        )
    found["plain torch, against the compiled kernels"] = _plain_difference(machine, width, height)
    here, there = _train_twins(machine)
    found["200 steps here and on the CPU"] = abs(here - there)
    return found


def measure_rasterizer(machine: Machine) -> dict[str, float]:
    """Time images and gradients of a street block, by `hybridworldsim.rasterizer` and by gsplat called directly."""
    found, each_s = {}, BUDGETS_S["rasterizer"] / (4 * len(GAUSSIANS))
    width, height = machine.size_px()
    for count in GAUSSIANS:
        scene, size = scenes.street(machine.count(count, 500)), f"{SIZES[count]} Gaussians"
        arguments = _arguments(scene, width, height, machine.device)
        for called, suffix in _rasterizers(machine).items():
            found[f"{size}, image{suffix}"] = machine.median_ms(_forward(called, arguments), each_s)
            found[f"{size}, image and gradients{suffix}"] = machine.median_ms(_both(called, arguments), each_s)
    return found


def measure_frames(machine: Machine) -> dict[str, float]:
    """Count frames of streets with random codes a second: decoding and rasterization, without a loop's other work."""
    found, each_s = {}, BUDGETS_S["frames"] / len(GAUSSIANS)
    width, height = machine.size_px()
    for count in GAUSSIANS:
        street = random_street(machine.count(count, 600)).to(machine.device)
        latent = street.appearance(SOURCE).detach()
        view = front_view(width, height)

        @torch.inference_mode()
        def render(street: StreetModel = street, latent: Tensor = latent, view: Viewpoint = view) -> object:
            return street(view, latent)

        ms = machine.median_ms(render, each_s)
        name = f"{SIZES[count]} Gaussians, {WIDTH_PX}x{HEIGHT_PX}, decoded and rasterized"
        found[name] = 1000.0 / ms
    return found


def random_street(gaussians: int, seed: int = 0) -> StreetModel:
    """Make a street of 100 m with random codes and a number of Gaussians: facades, trees, road and sky."""
    rng = np.random.default_rng(seed)
    background, ground, sky = (max(3, round(gaussians * share)) for share in _SHARES)
    anchors = max(1, background // 3)
    x = rng.uniform(-60.0, 60.0, anchors)
    side = rng.choice([-12.0, 12.0], anchors)
    wall = np.column_stack((x, side, rng.uniform(0.0, 12.0, anchors)))
    tree = np.column_stack((np.round(x / 15.0) * 15.0, np.sign(side) * 7.0, np.full(anchors, 5.0)))
    is_wall = rng.random((anchors, 1)) < 0.7
    places = np.where(is_wall, wall, tree + rng.normal(0.0, 1.2, (anchors, 3))).astype(np.float32)
    road = np.column_stack((rng.uniform((-60.0, -12.0), (60.0, 12.0), (ground, 2)), np.zeros(ground)))
    away = rng.normal(0.0, 1.0, (sky, 3))
    away = 300.0 * away / np.linalg.norm(away, axis=1, keepdims=True)
    away[:, 2] = np.abs(away[:, 2])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        settings = Settings()
        node = Anchors(
            torch.from_numpy(places), torch.full((anchors,), (2.0 * 120.0 * 12.0 / anchors) ** 0.5),
            75.0, offsets=3, code=settings.code, latent=settings.latent, hidden=settings.hidden,
        )  # fmt: skip
        flat = _seeds(road, (120.0 * 24.0 / ground) ** 0.5)
        street = StreetModel(
            node,
            CodeGaussians(flat, settings.plain_code, settings.latent, settings.hidden),
            CodeGaussians(
                _seeds(away, 300.0 * (6.3 / sky) ** 0.5), settings.plain_code, settings.latent, settings.hidden
            ),
            AppearanceLatents([SOURCE], settings.latent),
        )
        with torch.no_grad():
            for one in street.nodes:
                torch.nn.init.normal_(one.codes, std=1.0)
        return street


def front_view(width: int, height: int) -> Viewpoint:
    """Return a camera 1.5 m above the middle of a street that looks along it."""
    K = torch.tensor([[0.6 * width, 0.0, width / 2], [0.0, 0.6 * width, height / 2], [0.0, 0.0, 1.0]])
    viewmat = torch.eye(4)
    viewmat[:3, :3] = torch.tensor([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    viewmat[:3, 3] = -viewmat[:3, :3] @ torch.tensor([-30.0, 0.0, 1.5])
    return Viewpoint(width, height, K, viewmat, SOURCE)


def random_image(view: Viewpoint, seed: int) -> TrainingImage:
    """Return a smooth random image with depth, to train on."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.random((1, 3, 9, 16), np.float32))
    size = (view.height_px, view.width_px)
    rgb = torch.nn.functional.interpolate(coarse, size, mode="bilinear", align_corners=False)[0].permute(1, 2, 0)
    return TrainingImage(view, rgb.contiguous(), torch.ones(size, dtype=torch.bool), None, 5.0 + 20.0 * rgb[..., 0])


def _seeds(places: Any, size_m: float) -> Seeds:
    means = torch.from_numpy(np.ascontiguousarray(places, np.float32))
    quats = torch.zeros(len(means), 4)
    quats[:, 0] = 1.0
    return Seeds(means, quats, torch.full((len(means), 3), size_m), 0.9)


def _rasterizers(machine: Machine) -> Mapping[Callable[..., Any], str]:
    """The calls that are timed, and what the names of their figures end with."""
    device = torch.device(machine.device)

    def ours(**arguments: Any) -> Any:
        return rasterization(**arguments, preset=preset_on(device), nonfinite="cull")

    if not machine.is_gpu:
        return {ours: ""}
    import gsplat

    return {ours: "", gsplat.rasterization: ", gsplat called directly"}


def _arguments(scene: scenes.Splats, width: int, height: int, device: str) -> dict[str, Any]:
    tables = {name: torch.from_numpy(np.ascontiguousarray(getattr(scene, name))) for name in _NAMES}
    tables |= {
        "viewmats": torch.from_numpy(scene.viewmat[None].astype(np.float32)),
        "Ks": torch.from_numpy(scene.camera_matrix(width, height)[None].astype(np.float32)),
    }
    moved = {name: table.to(device) for name, table in tables.items()}
    return {**moved, "width": width, "height": height, "near_plane": 0.2, "render_mode": "RGB+ED"}


def _forward(called: Callable[..., Any], arguments: Mapping[str, Any]) -> Callable[[], object]:
    @torch.no_grad()
    def forward() -> object:
        return called(**arguments)

    return forward


def _both(called: Callable[..., Any], arguments: Mapping[str, Any]) -> Callable[[], object]:
    def both() -> object:
        leaves = {name: arguments[name].detach().requires_grad_() for name in _NAMES}
        images, alphas, _ = called(**{**arguments, **leaves})
        (images.mean() + alphas.mean()).backward()
        return leaves

    return both


def _image_and_gradients(scene: scenes.Splats, width: int, height: int, device: str) -> dict[str, Tensor]:
    arguments = _arguments(scene, width, height, device)
    leaves = {name: arguments[name].requires_grad_() for name in _NAMES}
    images, alphas, _ = rasterization(**arguments, preset=preset_on(torch.device(device)), nonfinite="cull")
    weights = torch.rand(images.shape, generator=torch.Generator().manual_seed(0)).to(device)
    # Depth is in metres.
    weights[..., -1] *= 0.01
    ((images * weights).sum() + alphas.sum()).backward()
    gradients = {name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for name, leaf in leaves.items()}
    return {"image": images[..., :3].detach().cpu(), **{name: one.cpu() for name, one in gradients.items()}}


def _plain_difference(machine: Machine, width: int, height: int) -> float:
    """The largest difference of decoded Gaussians, losses and gradients, as a share of the largest number."""
    view, street = front_view(width, height), random_street(machine.count(30_000, 600))
    shown = random_image(view, 0)

    def compute(device: str) -> list[Tensor]:
        moved = street.to(device)
        latent = moved.appearance(SOURCE)
        with torch.no_grad():
            parts = moved.decode(view, latent, latent)
        image = shown.to(torch.device(device))
        given = (0.9 * image.rgb).requires_grad_()
        depth_m = (6.0 + 20.0 * shown.rgb[..., 1]).to(device).requires_grad_()
        stereo = 5.0 + 20.0 * image.rgb[..., 0]
        losses = torch.stack([
            colour_loss(given, image.rgb, image.scored), structure_loss(given, image.rgb, image.scored),
            depth_loss(depth_m, stereo, image.scored), normal_loss(depth_m, stereo, image.scored, view.K),
        ])  # fmt: skip
        losses.sum().backward()
        tables = [table for part in parts for table in (part.means, part.opacities, part.colours)]
        gradients = [one.grad for one in (given, depth_m) if one.grad is not None]
        return [table.detach().cpu() for table in (*tables, losses, *gradients)]

    expected = compute("cpu")
    if machine.is_gpu:
        found = compute(machine.device)
    else:
        with plain_torch():
            found = compute("cpu")
    street.to("cpu")
    return max(
        float((one - other).abs().max() / one.abs().max().clamp_min(1e-12)) if one.shape == other.shape else 1.0
        for one, other in zip(expected, found, strict=True)
    )


def _train_twins(machine: Machine) -> tuple[float, float]:
    """Train a street on the device and on the CPU; return the PSNR of both. On a CPU its twin is in plain torch."""
    width, height = machine.size_px(240, 135)
    shown = [random_image(front_view(width, height), seed) for seed in range(1)]
    steps = machine.count(_STEPS, 20)

    def train(device: str) -> float:
        street = corridor(machine.count(6_000, 300))
        settings = Settings(refinement=AnchorRefinement(begin=0.98, end=1.0), depth_weight=0.0, normal_weight=0.0)
        trainer = StreetTrainer(street, settings).to(device)
        for step in range(steps):
            report = trainer.step(shown[step % len(shown)], step / steps)
        return -10.0 * float(np.log10(report.losses["rgb"]))

    there = train("cpu")
    if machine.is_gpu:
        return train(machine.device), there
    with plain_torch():
        return train("cpu"), there


def _farthest(one: Tensor, other: Tensor) -> float:
    return float((one - other).abs().max())
