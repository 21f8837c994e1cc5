"""Measures rendering and training of a street's block, and its error against float64."""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import torch

from benchmarks.report import Peer, Row, report
from benchmarks.street.learning import learning_rows
from benchmarks.street.reference_model import plain_image, to_float64
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.storage import load_block, save_block
from hybridworldsim.model.street import StreetModel, StreetOutput
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror.arrays import Float64

WIDTH, HEIGHT = 480, 270
FRAME_MS = 100.0
PAPER_MS = 1000.0 / 21.0
_SOURCE = Source("s.a.0", "front_wide")
_ANCHORS = 30_000
_ONE_LEVEL = 1.0 / 255.0  # a Gaussian at the threshold of what is blended may fall on either side

_Result = TypeVar("_Result")
_View = TypeVar("_View")


def corridor(anchors: int = _ANCHORS, seed: int = 0) -> StreetModel:
    """Return an untrained block of 100 m with random codes: facades on both sides, trees, road, sky."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-60.0, 60.0, anchors)
    wall = np.column_stack((x, rng.choice([-12.0, 12.0], anchors), rng.uniform(0.0, 12.0, anchors)))
    tree = np.column_stack((np.round(x / 15.0) * 15.0, np.sign(wall[:, 1]) * 7.0, np.full(anchors, 5.0)))
    points = np.where(rng.random((anchors, 1)) < 0.7, wall, tree + rng.normal(0.0, 1.2, (anchors, 3)))
    way = np.column_stack((np.arange(-50.0, 51.0), np.zeros(101), np.zeros(101)))
    far = rng.normal(0.0, 1.0, (4000, 3))
    far = 150.0 * far / np.linalg.norm(far, axis=1, keepdims=True)
    far[:, 2] = np.abs(far[:, 2])

    def flat(places: Float64) -> tuple[Float64, Float64]:
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    settings = Settings(
        first_anchors=anchors, first_spacing_m=0.2, refinement=AnchorRefinement(max_anchors=anchors), seed=seed
    )
    street = initial_street(InitialGeometry(points, far, way, flat, 75.0, [_SOURCE]), settings)
    with torch.no_grad():
        for node in (street.background, street.ground, street.sky):
            torch.nn.init.normal_(node.codes, std=1.0)
    return street


def round_views(street: StreetModel, count: int = 24) -> list[Viewpoint]:
    """Return the views from 1.5 m above the ground near the middle of a block, in all directions."""
    ground = street.ground.means.detach()
    middle = ground[(ground[:, :2] - ground[:, :2].mean(0)).norm(dim=1).argmin()]
    K = torch.tensor([[0.6 * WIDTH, 0.0, WIDTH / 2], [0.0, 0.6 * WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]])
    found = []
    for angle in np.linspace(0.0, 2.0 * np.pi, count, endpoint=False):
        forward = torch.tensor([np.cos(angle), np.sin(angle), 0.0])
        down = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
        rotation = torch.stack([torch.linalg.cross(down, forward), down, forward]).float()
        viewmat = torch.eye(4)
        viewmat[:3, :3] = rotation
        viewmat[:3, 3] = -rotation @ (middle + torch.tensor([0.0, 0.0, 1.5]))
        found.append(Viewpoint(WIDTH, HEIGHT, K, viewmat, street.appearance.sources[0]))
    return found


def rows(street: StreetModel, views: Sequence[Viewpoint], name: str) -> list[Row]:
    """Return the times and errors of a street's images.

    Args:
        street: a trained street.
        views: the views.
        name: name of the street.
    """
    latent = street.appearance(views[0].source).detach()

    @torch.inference_mode()
    def render_image(view: Viewpoint) -> StreetOutput:
        return street(view, latent)

    @torch.inference_mode()
    def decode(view: Viewpoint) -> object:
        return street.decode(view, latent, latent)

    found, wall_ms = time_views(render_image, views)
    core_ms, decode_ms = time_views(render_image, views, time.process_time)[1], time_views(decode, views)[1]
    true = to_float64(street)
    errors = [(one.rgb - plain_image(true, one, view, latent)).abs().max() for one, view in zip(found, views)]
    output = float(np.mean([sum(map(len, one.parts)) for one in found]))
    held = sum(part.stored_count for part in found[0].parts)
    size = f"{WIDTH} x {HEIGHT}, {len(street.background)} anchors, {output:.0f} of {held} Gaussians drawn"
    peers = (Peer("paper, quoted", PAPER_MS),)
    threads = torch.get_num_threads()
    return [
        Row(f"{name}: image", size, wall_ms, float(torch.stack(errors).max()), peers, "of 1", FRAME_MS, _ONE_LEVEL),
        Row(f"{name}: decode alone", size, decode_ms),
        Row(f"{name}: image, processor time of all threads", size, core_ms),
        Row(f"{name}: images a second, {threads} threads", size, 1000.0 / wall_ms),
    ]


def half_precision_rows(street: StreetModel, views: Sequence[Viewpoint], name: str) -> list[Row]:
    """Return the size saved and error caused by half precision."""
    block = Block((0, 0), (0.0, 0.0, 0.0))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "block.safetensors"
        whole = save_block(path, block, street)
        half = save_block(path, block, street, half=True)
        _, other, _ = load_block(path)
    latent = street.appearance(views[0].source).detach()
    with torch.inference_mode():
        pairs = [[one(view, latent).rgb.clamp(0.0, 1.0) for one in (street, other)] for view in views]
    error = torch.stack([(ours - theirs).square().mean() for ours, theirs in pairs]).mean()
    loss = float(-10.0 * error.clamp_min(1e-12).log10())
    size = f"{len(street.background)} anchors, {len(street.ground) + len(street.sky)} others"
    return [
        Row(f"{name}: MB in float32", size, whole / 1e6),
        Row(f"{name}: MB in half precision", size, half / 1e6, loss, unit="dB PSNR to float32"),
    ]


def time_views(
    call: Callable[[_View], _Result], views: Sequence[_View], clock: Callable[[], float] = time.perf_counter
) -> tuple[list[_Result], float]:
    """Return the results, and the mean over views of the smallest of three times in milliseconds."""
    results = [call(view) for view in views]
    least = []
    for view in views:
        times = []
        for _ in range(3):
            begin = clock()
            call(view)
            times.append(clock() - begin)
        least.append(min(times))
    return results, 1000.0 * float(np.mean(least))


def main(argv: Sequence[str]) -> int:
    """Measure a street of random codes, and the given models."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks street", description=__doc__)
    parser.add_argument("models", nargs="*", type=Path, help="model.safetensors of trained blocks")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args(argv)
    torch.set_num_threads(arguments.threads)
    streets = {"chance": corridor()} | {path.parent.name: load_block(path)[1] for path in arguments.models}
    groups: dict[str, Iterable[Row]] = {"learning": learning_rows()}
    for name, street in streets.items():
        views = round_views(street)
        groups[name] = itertools.chain(rows(street, views, name), half_precision_rows(street, views, name))
    return report("street", groups)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
