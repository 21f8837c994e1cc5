"""Rendering of the synthetic street: time on one core against the error relative to 64 rays per pixel.

``python -m benchmarks synth [--views N]``. The error of an image is the root mean square difference, in 8-bit steps, to
the mean of 64 rays per pixel. Each of these rays has its own shading and textures averaged over an eighth of the pixel;
both images are developed without noise. 2.55 steps are 40 dB. Times are warm medians over views along the main street;
compilation has its own row. Other numbers of rays per pixel are listed as peers. The figures of ray casting with a
bounding-volume hierarchy are quoted; they were measured on a similar machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.report import Peer, Row, report
from mirror.arrays import Float32, Float64, UInt8
from mirror.geometry import Poses, matrix_from_quaternion, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.schema.documents import Roi
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.light.sun import instant_of
from mirror.synth.model import Label, Material, Model
from mirror.synth.render.develop.camera_response import CameraResponse
from mirror.synth.render.develop.developing import develop
from mirror.synth.render.lens import Lens, make_lens
from mirror.synth.render.sample_rays import OFFSETS
from mirror.synth.render.scene import Instant, Scene
from mirror.synth.render.view import rasterize_view
from mirror.synth.render.wet import add_reflections
from mirror.synth.street.world import World, build_world

PLACE: Final = (8.41694, 49.01252)
FORTY_DB: Final = 2.55
FINE: Final = 8
REPEATS: Final = 7
_EYE_M: Final = 1.5
_EGO_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_BARS: Final = {("day", 960): 150.0, ("night", 960): 250.0, ("day", 480): 50.0, ("night", 480): 250.0 / 3.0}
# Plain ray casting of 300 to 5,000 boxes through a bounding-volume hierarchy, with shadow rays: 160-290 ms at 36 dB.
_QUOTED: Final = Peer("BVH ray casting, quoted", 225.0, 255.0 * 10 ** (-36 / 20))

_CHILD: Final = """
import time
start = time.perf_counter()
import benchmarks.synth as bench
imported = time.perf_counter()
view = next(bench.make_views(bench.build_city(), "day", "clear", 1, 960))
world = time.perf_counter()
bench.render_view(view)
print(imported - start, world - imported, time.perf_counter() - world)
"""


@dataclass(frozen=True, eq=False)
class BenchmarkView:
    """A view to be rendered.

    Attributes:
        scene: scene in a condition.
        instant: instant of the scene.
        lens: lens of the camera.
        pose: pose of the camera.
    """

    scene: Scene
    instant: Instant
    lens: Lens
    pose: Poses

    @property
    def origin(self) -> Float64:
        """Position (3,) of the camera, world metres."""
        return self.pose.translation[0]

    @property
    def rotation(self) -> Float64:
        """Rotation (3, 3) world_R_camera."""
        return matrix_from_quaternion(self.pose.rotation)[0]


def build_city() -> World:
    """Build the urban scene with a radius of 200 m."""
    roi = Roi(
        scene_id="benchmark", longitude_deg=PLACE[0], latitude_deg=PLACE[1], radius_m=200.0, city="Karlsruhe",
        scene_type="urban", height_m=115.0,
    )  # fmt: skip
    return build_world(roi, 24.0, 1)


def make_views(world: World, light: str, weather: str, views: int, width: int) -> Iterator[BenchmarkView]:
    """Yield views along the longest lane, forwards and to the sides, without noise and automatic exposure."""
    start = instant_of("2025-06-01", light, *PLACE)  # type: ignore[arg-type]
    effects = Effects(noise=False, exposure=False)
    scene = Scene(world, Condition(start, light, weather, effects=effects), world.parked, Model.empty())  # type: ignore[arg-type]
    height = width * 9 // 16
    focal = 0.5 * width
    lens = make_lens(Camera("pinhole", width, height, focal, focal, 0.5 * width, 0.5 * height, ()))
    lane = max((lane for lane in world.network.lanes.values() if lane.use == "drive"), key=lambda lane: lane.length_m)
    for number in range(views):
        at = int((0.15 + 0.7 * number / max(views - 1, 1)) * (len(lane.line) - 3))
        ahead = lane.line[at + 2] - lane.line[at]
        course = float(np.arctan2(ahead[1], ahead[0]))
        yaw = course + (0.0, 0.0, 0.9, -0.9)[number % 4]
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        place = lane.line[at] + (0.0, 0.0, _EYE_M)
        pose = Poses(quaternion_from_matrix((turn @ _EGO_R_CAMERA)[None]), place[None])
        ego = Poses(np.array([[np.cos(0.5 * course), 0.0, 0.0, np.sin(0.5 * course)]]), lane.line[at][None])
        yield BenchmarkView(scene, scene.at(3.0, ego), lens, pose)


def render_view(view: BenchmarkView) -> UInt8:
    """Render a view."""
    return view.scene.render(view.instant, view.lens, view.pose).bgr


def render_radiance(view: BenchmarkView, offsets: Float32, footprint_px: float) -> Float32:
    """Return the radiance (H, W, 3) of a view with other rays per pixel."""
    surroundings = view.instant.surroundings
    radiance = rasterize_view(surroundings, view.lens, view.rotation, view.origin, offsets=offsets).radiance(
        footprint_px
    )
    if view.scene.light.record["wet"] > 0.0:
        radiance = add_reflections(radiance, surroundings, view.lens, view.rotation, view.origin)
    return np.ascontiguousarray(radiance[..., :3])


def develop_view(view: BenchmarkView, light: Float32) -> UInt8:
    """Develop radiance to an image as the renderer does."""
    return develop(light, view.scene.light.record, CameraResponse(), view.scene.condition.effects, 0)


def reference(view: BenchmarkView) -> UInt8:
    """Return the image with 64 rays per pixel."""
    total = np.zeros((*view.lens.rays.shape[:2], 3))
    for row in range(FINE):
        for column in range(FINE):
            offset = np.array([[(column + 0.5) / FINE - 0.5, (row + 0.5) / FINE - 0.5]], np.float32)
            total += render_radiance(view, offset, 1.0 / FINE)
    return develop_view(view, (total / FINE**2).astype(np.float32))


def rms_steps(image: UInt8, truth: UInt8) -> float:
    """Return the root mean square difference, in 8-bit steps."""
    return float(np.sqrt(np.mean((image.astype(np.float64) - truth) ** 2)))


def ray_grid(side: int) -> Float32:
    """Return the rays (side^2, 2) of a pixel on a regular grid."""
    at = (np.arange(side) + 0.5) / side - 0.5
    return np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2).astype(np.float32)


def view_rows(world: World, views: int) -> Iterator[Row]:
    """Yield the time and the error by light and image size."""
    for light, weather in (("day", "clear"), ("night", "rain")):
        for width in (960, 480):
            times, errors, others = [], [], {1: ([], []), 16: ([], [])}  # type: ignore[var-annotated]
            for view in make_views(world, light, weather, views, width):
                truth = reference(view)
                times.append(_median_ms(lambda view=view: render_view(view)))
                errors.append(rms_steps(render_view(view), truth))
                for rays, (spent, off) in others.items():
                    start = time.perf_counter()
                    other = develop_view(view, render_radiance(view, ray_grid(round(rays**0.5)), 1.0))
                    spent.append((time.perf_counter() - start) * 1e3)
                    off.append(rms_steps(other, truth))
            peers = [
                Peer(f"{rays} rays a pixel", float(np.median(spent)), float(np.max(off)))
                for rays, (spent, off) in others.items()
            ]
            worst = max(errors)
            yield Row(
                f"{'wet ' if weather == 'rain' else ''}{light}, {len(OFFSETS)} rays a pixel",
                f"{width}x{width * 9 // 16}",
                float(np.median(times)),
                worst,
                (*peers, *([_QUOTED] if (light, width) == ("day", 960) else [])),
                f"steps ({20 * np.log10(255 / worst):.1f} dB)",
                _BARS[light, width],
                FORTY_DB,
            )


def truth_rows(world: World, views: int) -> Iterator[Row]:
    """Yield the cost of depth, normals, classes and instances in addition to an image."""
    alone, beside = [], []
    for view in make_views(world, "day", "clear", views, 960):
        rasterized = view.scene.render(view.instant, view.lens, view.pose).view

        def truth(view: BenchmarkView = view) -> None:
            result = rasterize_view(view.instant.surroundings, view.lens, view.rotation, view.origin)
            _ = result.distance_m, result.normal, result.label, result.object

        def surfaces_only(view: BenchmarkView = view) -> None:
            rasterize_view(view.instant.surroundings, view.lens, view.rotation, view.origin)

        alone.append(_median_ms(lambda view=view: render_view(view)))
        beside.append(_median_ms(truth) - _median_ms(surfaces_only))
        counts = rasterized.counts
    share = 100.0 * float(np.median(beside)) / float(np.median(alone))
    yield Row("truth beside an image, % of its time", "960x540", share, bar=30.0)
    yield Row(
        "pairs of tile and surface tried, % of all", f"{counts['surfaces']} surfaces",
        100.0 * counts["tried"] / (counts["tiles"] * counts["surfaces"]),
    )  # fmt: skip


def preparation_rows(world: World) -> Iterator[Row]:
    """Yield one-time costs: world, shadows, instant, compilation."""
    inside = _within(world, 200.0)
    yield Row(
        "primitives within 200 m, no ground, no leaves", "urban", inside, 0.0 if inside >= 3000 else 1.0, error_bar=0.5
    )
    yield Row("a world", "urban", _median_ms(build_city, 3))
    start = instant_of("2025-06-01", "day", *PLACE)
    condition = Condition(start, "day", "clear")

    def prepare_scene() -> None:
        Scene(world, condition, world.parked, Model.empty()).prepare()

    yield Row("shadows and leaves of a condition", "urban", _median_ms(prepare_scene, 3))
    scene = Scene(world, condition, world.parked, Model.empty())
    yield Row("an instant", f"{len(scene.road_users)} users", _median_ms(lambda: scene.around(1.0, np.zeros(3))))
    with tempfile.TemporaryDirectory() as cache:
        for name in ("first image, compiling", "first image, compiled before"):
            took = _child(cache)
            yield Row(name, "960x540", 1e3 * took[2])


def _within(world: World, radius: float) -> int:
    faces, rounds, corners = world.model.faces, world.model.rounds, world.model.corners
    middle = np.add.reduceat(corners, faces["first"], axis=0) / faces["count"][:, None]
    near = np.concatenate([np.hypot(*middle.T[:2]), np.hypot(*rounds["centre"].T[:2])]) < radius
    label = np.concatenate([faces["label"], rounds["label"]])
    leaf = np.concatenate([faces["material"], rounds["material"]]) == Material.LEAVES
    return int((near & (label > Label.TERRAIN) & ~leaf).sum())


def _child(cache: str) -> list[float]:
    """Seconds for imports, world and first image in a new process."""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD], capture_output=True, text=True, check=True,
        env=dict(os.environ, NUMBA_CACHE_DIR=cache),
    )  # fmt: skip
    return [float(word) for word in done.stdout.split()]


def _median_ms(call: object, repeats: int = REPEATS) -> float:
    from benchmarks.report import median_ms

    return median_ms(call, repeats)  # type: ignore[arg-type]


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth", description=__doc__)
    parser.add_argument("--views", type=int, default=6, help="views of each kind")
    options = parser.parse_args(argv)

    import cv2

    cv2.setNumThreads(1)
    world = build_city()
    groups = {
        "images": view_rows(world, options.views),
        "truth": truth_rows(world, options.views),
        "made once": preparation_rows(world),
    }
    return report("synth", groups, errors="8-bit steps, root mean square")
