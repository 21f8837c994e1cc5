"""One step of each part at the paper's size in plain torch, beside the compiled form of the CPU."""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.splats import SOURCE, front_view, random_image, random_street
from benchmarks.plain_torch.facade import make_images, true_depth
from hybridworldsim.generation.network.configuration import SMALL, TINY, TINY_REFERENCES
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.costs import empty_conditions
from hybridworldsim.generation.training.generator_trainer import predict_velocity
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.mvs.fusion import PosedDepth, confirm
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from hybridworldsim.mvs.sky import find_sky
from hybridworldsim.rasterizer.covers import covered_before
from hybridworldsim.simulator.renderers import compositing
from hybridworldsim.simulator.renderers import plain_compositing as plain
from hybridworldsim.simulator.renderers.agent_layer import AgentImage
from mirror.arrays import AnyArray
from mirror_baselines.splatting.row_adam import RowAdam

GAUSSIANS: Final = 3_000_000
CAMERAS: Final = 7
_GENERATED_PX: Final = (448, 256)
_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_AT: Final = np.array([3.0, -1.0, 1.5])

T = TypeVar("T")


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        name: what was computed.
        seconds: processor time of plain torch.
        memory_gb: the process's peak until then.
        agreement: how far the compiled form is apart, in words.
    """

    name: str
    seconds: float
    memory_gb: float
    agreement: str

    def __str__(self) -> str:
        return f"| {self.name} | {self.seconds:.1f} s | {self.memory_gb:.1f} GB | {self.agreement} |"


def step_street(machine: Machine) -> Line:
    """Train a street of three million Gaussians for a step: all losses, dense Adam, statistics of refinement."""
    count, (width, height) = machine.count(GAUSSIANS, 600), machine.size_px()
    settings = Settings(structure_weight=0.1, refinement=AnchorRefinement(begin=0.0, end=1.0, times=1))
    shown = random_image(front_view(width, height), 0)

    def step() -> dict[str, float]:
        return dict(StreetTrainer(random_street(count), settings, dense=True).step(shown, 0.0).losses)

    found, line = _measure(f"a training of {count:,} Gaussians, {width}x{height}", step)
    expected = step()
    apart = max(abs(found[name] / value - 1.0) for name, value in expected.items())
    return replace(line, agreement=f"losses within {apart:.0e}")


def update_rows(machine: Machine) -> Line:
    """Update a third of the rows of explicit Gaussians with harmonics of degree 3, by selective Adam."""
    count, columns = machine.count(GAUSSIANS, 600), 59
    generator = torch.Generator().manual_seed(0)
    rows = torch.randperm(count, generator=generator)[: count // 3].sort().values
    gradients = torch.randn(len(rows), columns, generator=generator)

    def update() -> Tensor:
        table = nn.Parameter(torch.ones(count, columns))
        adam = RowAdam(table)
        adam.param_groups[0]["lr"] = 1e-2
        adam.update(rows, gradients)
        return table.detach()

    found, line = _measure(f"selective Adam, {len(rows):,} of {count:,} rows of {columns}", update)
    return replace(line, agreement=f"numbers within {float((found - update()).abs().max()):.0e}")


def sweep_depth(machine: Machine) -> Line:
    """Estimate the depth of an image from four sources, with 128 facing planes and 32 of the road."""
    reference, sources = make_images(*machine.size_px())
    sweep = PlaneSweep()
    found, line = _measure(
        f"plane sweep of an image, {reference.rgb.shape[1]}x{reference.rgb.shape[0]}, 160 planes, 4 sources",
        lambda: sweep(reference, sources, 2.0, 200.0),
    )
    expected = sweep(reference, sources, 2.0, 200.0)
    known = np.isfinite(expected.depth_m)
    both = known & np.isfinite(found.depth_m)
    share = np.abs(found.depth_m - expected.depth_m)[both] / expected.depth_m[both]
    return replace(
        line,
        agreement=f"{known.mean():.0%} known, {(known != np.isfinite(found.depth_m)).mean():.1e} of the pixels in one "
        f"form only, 99.9 % within {np.quantile(share, 0.999):.0e}",
    )


def confirm_depth(machine: Machine) -> Line:
    """Compare a depth map with eight others."""
    reference, sources = make_images(*machine.size_px())
    maps = [PosedDepth(true_depth(one), one.K, one.world_SE3_camera) for one in (reference, *sources, *sources)]
    found, line = _measure(
        f"fusion with eight depth maps, {maps[0].depth_m.shape[1]}x{maps[0].depth_m.shape[0]}",
        lambda: confirm(maps[0], maps[1:]),
    )
    expected = confirm(maps[0], maps[1:])
    apart = float((found.views != expected.views).mean())
    return replace(line, agreement=f"{apart:.0e} of the pixels with another count of images")


def mask_sky(machine: Machine) -> Line:
    """Find the sky of an image."""
    image, _ = make_images(*machine.size_px())
    unknown = np.full(image.valid.shape, np.nan, np.float32)
    unknown[len(unknown) // 2 :] = 9.0
    found, line = _measure(
        f"mask of the sky, {image.rgb.shape[1]}x{image.rgb.shape[0]}", lambda: find_sky(image, unknown)
    )
    expected = find_sky(image, unknown)
    return replace(line, agreement=f"{(found != expected).mean():.1e} of the pixels differ, {expected.mean():.0%} sky")


def compose_images(machine: Machine) -> Line:
    """Put agents and four contact shadows into the images of seven cameras."""
    width, height = machine.size_px()
    rng = np.random.default_rng(0)
    lens = np.array([0.6 * width, 0.6 * width, width / 2, height / 2])
    below = np.maximum((np.arange(height)[:, None] + 0.5 - lens[3]) / lens[1], 1e-9)
    depth = np.minimum(_AT[2] / below, rng.uniform(6.0, 60.0, (1, width))).astype(np.float32)
    alpha = np.zeros((height, width), np.float32)
    alpha[height // 3 : 2 * height // 3, width // 4 : width // 2] = 1.0
    agents = AgentImage(
        rng.integers(0, 256, (height, width, 3), dtype=np.uint8), alpha,
        np.where(alpha > 0.0, 12.0, np.inf).astype(np.float32), np.zeros((height, width), np.int32),
    )  # fmt: skip
    rgb, covered = rng.integers(0, 256, (height, width, 3), dtype=np.uint8), rng.random((height, width), np.float32)
    boxes = np.array([[12.0 + 5.0 * one, -1.0, 0.0, 0.3 * one, 2.2, 0.9] for one in range(4)])
    free = compositing.free_space([np.array([(0.0, -6.0), (60.0, -6.0), (60.0, 4.0), (0.0, 4.0)])], (0.0, 0.0), 60.0)
    camera = lens, _R_CAMERA, _AT
    limit_m = compositing.hiding_depth(agents)

    def compiled() -> AnyArray:
        image = rgb.copy()
        compositing.add_contact_shadows(image, depth, *camera, boxes)
        return compositing.compose(image, depth, covered, agents, *camera, free)[0]

    def plainly() -> AnyArray:
        image, depth_m, share = (torch.from_numpy(one.copy()) for one in (rgb, depth, covered))
        plain.add_contact_shadows(image, depth_m, *camera, boxes)
        layer = plain.AgentTensors(*(torch.from_numpy(one) for one in (agents.rgb, alpha, limit_m)))
        shown = torch.from_numpy(free.is_free)
        return plain.compose(image, depth_m, share, layer, *camera, shown, free.origin_m)[0].numpy()

    images, line = _measure(
        f"composition of {CAMERAS} cameras, {width}x{height}", lambda: [plainly() for _ in range(CAMERAS)]
    )
    return replace(line, agreement=f"{int((images[0] != compiled()).sum())} bytes of an image differ")


def cover_pixels(machine: Machine) -> Line:
    """Compute what the Gaussians of a street cover before an agent."""
    count, (width, height) = machine.count(GAUSSIANS, 600), machine.size_px()
    street = random_street(count)
    with torch.no_grad():
        output = street(front_view(width, height), street.appearance(SOURCE))
    limit_m = np.zeros((height, width), np.float32)
    limit_m[height // 3 : 2 * height // 3, width // 4 : width // 2] = 25.0
    found, line = _measure(
        f"covered shares of {int((limit_m > 0).sum()):,} pixels, {count:,} Gaussians",
        lambda: covered_before(output.meta, limit_m),
    )
    apart = float((found - covered_before(output.meta, limit_m)).abs().max())
    return replace(line, agreement=f"shares within {apart:.0e}")


def step_generator(machine: Machine) -> Line:
    """Train the generator of seven views for a step with a batch of one; all of it is torch on any device."""
    config = SMALL if machine.scale == 1.0 else TINY
    width, height = machine.size_px(*_GENERATED_PX, multiple=config.token_px)
    grid = [side // config.latent_stride for side in (height, width)]
    frames = 1 if config.reference_channels else 1 + TINY_REFERENCES

    def step() -> Transformer:
        network = Transformer(config)
        adam = torch.optim.AdamW(network.parameters())
        references, noisy = (
            torch.randn(1, each, CAMERAS, config.latent_channels, *grid) for each in (TINY_REFERENCES, 1)
        )
        level, reference_level = torch.full((1, 1, CAMERAS), 0.5), torch.zeros(1, TINY_REFERENCES, CAMERAS)
        conditions = empty_conditions(config, (height, width), CAMERAS, machine.device, frames=frames)
        velocity = predict_velocity(network, noisy, references, conditions, level, reference_level)
        velocity.square().mean().backward()
        adam.step()
        return network

    network, line = _measure(f"a training of the generator, {CAMERAS} views of {width}x{height}", step)
    is_finite = all(bool(one.isfinite().all()) for one in network.parameters())
    count = sum(one.numel() for one in network.parameters())
    return replace(line, agreement=f"one form; {count:,} parameters, {'all finite' if is_finite else 'NOT FINITE'}")


def _measure(name: str, compute: Callable[[], T]) -> tuple[T, Line]:
    """Compute once in plain torch; return the result, and a line without an agreement."""
    gc.collect()
    begin = time.process_time()
    with plain_torch():
        found = compute()
    seconds = time.process_time() - begin
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)
    gc.collect()
    return found, Line(name, seconds, peak_gb, "")


PARTS: Final[Mapping[str, Callable[[Machine], Line]]] = {
    "street": step_street,
    "rows": update_rows,
    "depth": sweep_depth,
    "fusion": confirm_depth,
    "sky": mask_sky,
    "composition": compose_images,
    "covers": cover_pixels,
    "generator": step_generator,
}
"""The parts by name."""
