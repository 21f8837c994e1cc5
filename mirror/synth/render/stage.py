"""Pictures of a world, with its traffic, at any time and from any place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Records, UInt8
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.synth.lighting import Condition, lighting
from mirror.synth.render.casting import Lens
from mirror.synth.render.primitives import NO_OBJECT, SOLID, flat, meet, placed, radius_m
from mirror.synth.render.shading import BELOW_CELL_M, LAMP_CELL_M, SETTING, SHADOW_CELL_M, Surroundings
from mirror.synth.render.tracing import develop, seen_by, trace, trace_mirrored
from mirror.synth.road_users import Body, Placement, RoadUser
from mirror.synth.world import STREET, World

_LAMP_REACH_M: Final = 22.0
_DRAWN_WITHIN_M: Final = 170.0
_SHADED_WITHIN_M: Final = 50.0


@dataclass(frozen=True)
class Picture:
    """A rendered picture and the truth beside it.

    Attributes:
        bgr: (H, W, 3).
        distance_m: (H, W) along each pixel's ray; 1e9 for the sky.
        object: (H, W) number of the road user seen, NO_OBJECT for all else.
    """

    bgr: UInt8
    distance_m: Float32
    object: Int32


@dataclass(frozen=True)
class Instant:
    """Everything as it stands at one instant round the recording vehicle.

    Attributes:
        surroundings: for the tracer.
        placements: of the road users that are near enough to be drawn, by number.
    """

    surroundings: Surroundings
    placements: dict[int, Placement]


class Stage:
    """A world in one condition with its road users: makes instants, and pictures of them. Thread-safe.

    Args:
        world: what stands still.
        condition: light and weather.
        users: what moves; parked cars are the world's own. Objects are numbered in this order, parked cars last.
        own: solids of the recording vehicle in its ego frame.
    """

    def __init__(self, world: World, condition: Condition, users: Sequence[RoadUser], own: Records) -> None:
        roi = world.roi
        self.world, self.condition, self.own = world, condition, own
        self.users = (*users, *world.parked)
        self.look = lighting(condition, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0)

    @cached_property
    def _static(self) -> tuple[Float32, Float32, Records]:
        """Shadows of what stands still, light of the lamps, and the SETTING that does not change."""
        setting = np.zeros(1, SETTING)
        for name in self.look.dtype.names or ():
            setting[name] = self.look[name]
        setting["green"], setting["seed"] = self.world.green, self.world.seed
        across = np.cross([0.0, 0.0, 1.0], self.look["sun"])
        across /= np.linalg.norm(across)
        setting["sun_axes"] = across, np.cross(self.look["sun"], across)
        parked = [_standing(user, user.motion.at(0.0), NO_OBJECT) for user in self.world.parked]
        still, setting["still_origin"] = _shadows(np.concatenate([self.world.solids, *parked]), setting)
        lamps, setting["lamps_origin"] = _lamp_map(self.world)
        return still, lamps, setting

    def prepare(self) -> None:
        """Make now what all instants share."""
        _ = self._static

    def at(self, time_s: float, world_SE3_ego: Poses) -> Instant:
        """All that there is ``time_s`` after the start, round the recording vehicle at its pose."""
        ego, turn = world_SE3_ego.translation[0], matrix_from_quaternion(world_SE3_ego.rotation)[0]
        placements = {}
        for number, user in enumerate(self.users):
            place = user.motion.at(time_s)
            if math.hypot(place.x_m - ego[0], place.y_m - ego[1]) < _DRAWN_WITHIN_M:
                placements[number] = place
        first_parked = len(self.users) - len(self.world.parked)
        drawn = [
            _standing(self.users[number], place, number, lights=number < first_parked)
            for number, place in placements.items()
        ]
        nothing = np.zeros(0, SOLID)
        own = placed(self.own, turn, ego, NO_OBJECT)
        moving = np.concatenate([nothing, *(one for one, number in zip(drawn, placements) if number < first_parked)])
        solids = np.concatenate([self.world.solids, own, *drawn])
        still, lamps, setting = self._static
        setting = setting.copy()
        shadows, setting["moving_origin"] = _shadows(moving, setting)
        below, setting["below_origin"] = _below(
            [(self.users[number].body, place) for number, place in placements.items()], ego
        )
        setting["beam"] = *(ego + turn @ (3.4, 0.0, 0.7)), *(turn @ (0.998, 0.0, -0.06))
        surroundings = Surroundings(
            self.world.streets.view(flat(STREET)),
            solids.view(flat(SOLID)),
            still,
            shadows,
            lamps,
            below,
            setting.view(flat(SETTING))[0],
        )
        return Instant(surroundings, placements)

    def picture(self, instant: Instant, lens: Lens, world_SE3_camera: Poses, seed: int) -> Picture:
        """Render one picture.

        Args:
            instant: what there is.
            lens: the camera.
            world_SE3_camera: one pose.
            seed: of the noise.
        """
        scene = instant.surroundings
        rotation, origin = matrix_from_quaternion(world_SE3_camera.rotation)[0], world_SE3_camera.translation[0]
        radiance, distance, seen = trace(scene, lens, rotation, origin)
        mirrored = np.zeros((0, 0, 4), np.float32)
        if self.look["wet"] > 0.0:
            mirrored = trace_mirrored(scene, lens, rotation, origin, radiance[..., 3])
        numbers = np.concatenate([scene.solids["object"], [NO_OBJECT, NO_OBJECT]]).astype(np.int32)
        return Picture(develop(radiance, mirrored, scene.setting, seed), distance, numbers[seen])


def own_mask(lens: Lens, ego_SE3_camera: Poses, own: Records) -> UInt8:
    """Where a camera sees its own vehicle: (H, W), 255 there and 0 elsewhere.

    Args:
        lens: of the camera.
        ego_SE3_camera: its mounting.
        own: solids of the vehicle in its ego frame.
    """
    nothing = np.zeros((0, 0), np.float32)
    surroundings = Surroundings(
        np.zeros(0, flat(STREET)),
        own.view(flat(SOLID)),
        nothing,
        nothing,
        nothing,
        nothing,
        np.zeros(1, flat(SETTING))[0],
    )
    rotation = matrix_from_quaternion(ego_SE3_camera.rotation)[0]
    seen = seen_by(surroundings, lens, rotation, ego_SE3_camera.translation[0])
    return np.where(seen >= 0, 255, 0).astype(np.uint8)


def _motion(place: Placement) -> tuple[Float64, Float64]:
    cos, sin = math.cos(place.yaw_rad), math.sin(place.yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.array([place.x_m, place.y_m, 0.0])


def _standing(user: RoadUser, place: Placement, number: int, *, lights: bool = False) -> Records:
    solids = placed(user.body.solids, *_motion(place), number)
    solids["lights"] = lights
    return solids


def _shadows(solids: Records, setting: Records) -> tuple[Float32, Float64]:
    """How far towards the sun the solids reach, and where the map begins in the plane across its direction."""
    sun, axes = setting["sun"][0], setting["sun_axes"][0]
    if not setting["sunlight"].any() or not len(solids):
        return np.zeros((0, 0), np.float32), np.zeros(2)
    reach = radius_m(solids)
    plane = solids["centre"] @ axes.T
    low, high = (plane - reach[:, None]).min(axis=0), (plane + reach[:, None]).max(axis=0)
    columns, rows = np.ceil((high - low) / SHADOW_CELL_M).astype(int) + 1
    depth = np.full((rows, columns), -1e9, np.float32)
    _occlude(solids.view(flat(SOLID)), reach, sun, axes, low, SHADOW_CELL_M, depth)
    return depth, low


@njit(cache=True, nogil=True, error_model="numpy")
def _occlude(
    solids: Records, reach: Float64, sun: Float64, axes: Float64, low: Float64, cell: float, depth: Float32
) -> None:
    """Fill ``depth`` with how far towards the sun the last solid on each ray stands."""
    for index in range(len(solids)):
        one = solids[index]
        x, y, z = one.centre_0, one.centre_1, one.centre_2
        a, b = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z, axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        along = sun[0] * x + sun[1] * y + sun[2] * z
        start = along + reach[index] + 1.0
        first, last = math.floor((a - reach[index] - low[0]) / cell), math.ceil((a + reach[index] - low[0]) / cell)
        for row in range(
            max(math.floor((b - reach[index] - low[1]) / cell), 0),
            min(math.ceil((b + reach[index] - low[1]) / cell) + 1, depth.shape[0]),
        ):
            for column in range(max(first, 0), min(last + 1, depth.shape[1])):
                u, v = low[0] + column * cell, low[1] + row * cell
                t, face = meet(
                    one,
                    u * axes[0, 0] + v * axes[1, 0] + start * sun[0],
                    u * axes[0, 1] + v * axes[1, 1] + start * sun[1],
                    u * axes[0, 2] + v * axes[1, 2] + start * sun[2],
                    -sun[0],
                    -sun[1],
                    -sun[2],
                    1e9,
                )
                if face >= 0:
                    depth[row, column] = max(depth[row, column], start - t)


def _lamp_map(world: World) -> tuple[Float32, Float64]:
    edge = world.roi.radius_m + 80.0
    grid = np.arange(-edge, edge + LAMP_CELL_M, LAMP_CELL_M)
    light = np.zeros((len(grid), len(grid)))
    for x, y, z in world.lamps:
        rows = np.abs(grid - y) <= _LAMP_REACH_M
        columns = np.abs(grid - x) <= _LAMP_REACH_M
        square = (grid[columns] - x) ** 2 + (grid[rows] - y)[:, None] ** 2
        fade = np.clip(1.0 - square / _LAMP_REACH_M**2, 0.0, 1.0) ** 2
        light[np.ix_(rows, columns)] += fade * (z * z / (z * z + square)) ** 1.5
    return light.astype(np.float32), np.array([-edge, -edge])


def _below(bodies: Sequence[tuple[Body, Placement]], ego: Float64) -> tuple[Float32, Float64]:
    grid = np.arange(-_SHADED_WITHIN_M, _SHADED_WITHIN_M, BELOW_CELL_M)
    shade = np.zeros((len(grid), len(grid)), np.float32)
    for body, place in bodies:
        x, y = place.x_m - ego[0], place.y_m - ego[1]
        half, aside = 0.5 * body.size_m[0] - 0.1, 0.5 * body.size_m[1] - 0.1
        reach = half + 1.2
        columns = slice(*np.searchsorted(grid, (x - reach, x + reach)))
        rows = slice(*np.searchsorted(grid, (y - reach, y + reach)))
        cos, sin = math.cos(place.yaw_rad), math.sin(place.yaw_rad)
        dx, dy = grid[columns] - x, (grid[rows] - y)[:, None]
        beyond = np.hypot(
            np.maximum(np.abs(cos * dx + sin * dy) - half, 0.0), np.maximum(np.abs(cos * dy - sin * dx) - aside, 0.0)
        )
        shade[rows, columns] = 1.0 - (1.0 - shade[rows, columns]) * (1.0 - 0.8 * np.exp(-beyond / 0.22))
    return shade, ego[:2] - _SHADED_WITHIN_M
