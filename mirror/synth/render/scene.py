"""A world in one condition: prepares instants (surfaces, shadows, lamps) and renders images of them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float32, Float64, Int64, Records, UInt8
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.portable import arrays, scalars
from mirror.schema.documents import Roi
from mirror.synth.light.condition import Condition
from mirror.synth.light.lighting import LIGHTING, Lighting, compute_lighting
from mirror.synth.model import FACE, NO_IMAGE, NO_OBJECT, ROUND, Label, Model, flat, merge_models
from mirror.synth.render.binning import bounding_spheres
from mirror.synth.render.develop.camera_response import CameraResponse
from mirror.synth.render.develop.developing import develop
from mirror.synth.render.develop.motion import compute_image_motion
from mirror.synth.render.lens import Lens
from mirror.synth.render.lines import LineInstant, LinesView, render_lines
from mirror.synth.render.shadows import ShadowMap, render_shadow_map, sun_axes
from mirror.synth.render.surfaces import SurfaceBuffer
from mirror.synth.render.surroundings import (
    AMBIENT_OCCLUSION_CELL_M,
    GLOW_CELL_M,
    GROUND_CELL_M,
    LAMP_CELL_M,
    MAPS,
    Surroundings,
)
from mirror.synth.render.view import RasterizedView, rasterize_view
from mirror.synth.render.wet import add_reflections
from mirror.synth.road_users.body import Body, RoadUser
from mirror.synth.roads.markings import MARK, restrict_layouts
from mirror.synth.street.foliage import apply_season
from mirror.traffic.placement.motion import Placement, StaticMotion

_LAMP_REACH_M: Final = 22.0
_RENDER_RANGE_M: Final = 220.0
_SHADOW_RANGE_M: Final = 50.0
_BEYOND_M: Final = 80.0
_PLAIN: Final = CameraResponse()
_HEADLIGHTS_M: Final = np.array([3.4, 0.0, 0.7])
_AHEAD: Final = np.array([0.998, 0.0, -0.06])
_DRIVEN: Final = frozenset({"car", "van", "truck", "bus", "motorcycle"})
_BEAM_M: Final = 26.0


class Place(Protocol):
    """The static part of a world, which a scene uses."""

    @property
    def roi(self) -> Roi:
        """The region of interest."""
        ...

    @property
    def model(self) -> Model:
        """Ground, houses, plants in full leaf, furniture."""
        ...

    @property
    def layouts(self) -> Records:
        """(L, K) MARK: the markings of carriageways."""
        ...

    @property
    def lamps(self) -> Float64:
        """(M, 3) positions of the street lamps' lights, metres."""
        ...

    def height_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        """Return the heights of the ground, metres."""
        ...

    def find_lit_lamps(self, time_s: float) -> Int64:
        """Return the faces of traffic lights that are lit at a time of the signal cycle."""
        ...


@dataclass(frozen=True, eq=False)
class Instant:
    """The world around a position at one instant.

    Attributes:
        surroundings: input of the renderer.
        placements: placements of the road users near enough to be rendered, by number.
    """

    surroundings: Surroundings
    placements: dict[int, Placement]


class Twist(NamedTuple):
    """The motion of a camera during an exposure, in the camera frame.

    Attributes:
        velocity_mps: (3,) velocity.
        turn_radps: (3,) angular velocity.
        exposure_s: exposure time.
    """

    velocity_mps: tuple[float, float, float]
    turn_radps: tuple[float, float, float]
    exposure_s: float


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """A rendered image with its ground truth.

    Attributes:
        bgr: (H, W, 3) pixels, blue first.
        view: ground truth of the pixels: distances, normals, labels, objects.
    """

    bgr: UInt8
    view: RasterizedView


@dataclass(frozen=True, eq=False)
class RollingImage:
    """An image that was exposed line by line, with its ground truth.

    Attributes:
        bgr: (H, W, 3) pixels, blue first.
        view: ground truth of the pixels, each at the time of its line.
    """

    bgr: UInt8
    view: LinesView


class Scene:
    """A world in one condition with its road users. Thread-safe after `prepare`.

    Args:
        world: the static world.
        condition: light and weather.
        road_users: all other road users, including the parked ones; object numbers follow this order.
        ego_model: model of the recording vehicle in its ego frame.
        clock_s: time of the signal cycle at the start.
    """

    def __init__(
        self,
        world: Place,
        condition: Condition,
        road_users: Sequence[RoadUser],
        ego_model: Model,
        *,
        clock_s: float = 0.0,
    ) -> None:
        roi = world.roi
        self.world, self.condition, self.road_users, self.ego_model = world, condition, tuple(road_users), ego_model
        self.clock_s = clock_s
        self.light: Lighting = compute_lighting(condition, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0)

    @cached_property
    def _static(self) -> _StaticScene:
        world, condition = self.world, self.condition
        model = apply_season(
            world.model, float(self.light.record["season"]), condition.visit if condition.effects.foliage else 0
        )
        _change_images(model, condition.visit if condition.effects.billboards else 0)
        model, layouts = restrict_layouts(model, world.layouts)
        # Parked vehicles and other static road users are placed once.
        model = merge_models(
            [
                model,
                *(self._stand_model(number, user) for number, user in enumerate(self.road_users) if _is_static(user)),
            ]
        )
        maps = np.zeros(1, MAPS)
        sun = np.array(self.light.record["sun"])
        maps["sun_axes"] = sun_axes(sun)
        shadow = ShadowMap.none()
        reach = world.roi.radius_m + _BEYOND_M
        if self.light.record["shadows"] and self.light.record["sunlight"].any():
            casting = model.faces["label"] > Label.TERRAIN
            shadow = render_shadow_map(
                Model(model.faces[casting], model.corners, model.rounds), sun, np.zeros(3), reach
            )
        maps["static_shadow_origin"] = shadow.origin
        lamps, maps["lamps_origin"] = _lamp_map(world.lamps, reach)
        grid = np.arange(-reach, reach + GROUND_CELL_M, GROUND_CELL_M)
        x, y = np.meshgrid(grid, grid)
        ground = np.asarray(world.height_m(x.ravel(), y.ravel())).reshape(x.shape).astype(np.float32)
        maps["ground_origin"] = -reach
        spheres = bounding_spheres(model.faces.view(flat(FACE)), model.corners, model.rounds.view(flat(ROUND)))
        return _StaticScene(model, spheres, shadow, lamps, ground, layouts, maps)

    def with_road_users(self, road_users: Sequence[RoadUser], ego_model: Model, *, clock_s: float = 0.0) -> Scene:
        """Return the scene with other road users, which shares the parts that do not depend on them.

        Raises:
            UsageError: a road user of one of the scenes stands for good: the fixed part then depends on it.
        """
        if any(_is_static(user) for user in (*self.road_users, *road_users)):
            raise UsageError("a road user that never moves", place="road_users", expected="road users with a motion")
        self.prepare()
        other = copy.copy(self)
        other.road_users, other.ego_model, other.clock_s = tuple(road_users), ego_model, clock_s
        return other

    def prepare(self) -> None:
        """Compute the parts that all instants share."""
        _ = self._static

    def at(self, time_s: float, world_SE3_ego: Poses, *, buffer: SurfaceBuffer | None = None) -> Instant:
        """Return the world ``time_s`` after the start, around the recording vehicle at a pose.

        Args:
            time_s: seconds after the start.
            world_SE3_ego: pose of the recording vehicle.
            buffer: arrays for the surfaces, which those of the next instant in them overwrite; None: new arrays.
        """
        ego, turn = world_SE3_ego.translation[0], matrix_from_quaternion(world_SE3_ego.rotation)[0]
        moving, placements = self._moving(time_s, ego)
        ego_model = self._place_ego(turn, ego)
        beam = np.concatenate([ego + arrays.matmul(turn, _HEADLIGHTS_M), arrays.matmul(turn, _AHEAD)])
        return self._instant(time_s, merge_models([moving, ego_model]), moving, placements, ego, beam, buffer)

    def _place_ego(self, turn: Float64, ego: Float64) -> Model:
        """Place the model of the recording vehicle in the world."""
        model = self.ego_model.transform(turn, ego, NO_OBJECT)
        model.faces["label"], model.rounds["label"] = Label.EGO, Label.EGO
        return model

    def around(self, time_s: float, place_m: Float64) -> Instant:
        """Return the world ``time_s`` after the start, around a position (3,), without a recording vehicle."""
        moving, placements = self._moving(time_s, place_m)
        return self._instant(time_s, moving, moving, placements, place_m, np.zeros(6))

    def _moving(self, time_s: float, middle: Float64) -> tuple[Model, dict[int, Placement]]:
        placements = {}
        traffic = self.condition.effects.traffic
        for number, user in enumerate(self.road_users):
            if not (traffic or _is_static(user)):
                continue
            place = user.motion.at(time_s)
            if scalars.hypot(place.x_m - middle[0], place.y_m - middle[1]) < _RENDER_RANGE_M:
                placements[number] = place
        moving = {key: place for key, place in placements.items() if not _is_static(self.road_users[key])}
        return self._place(moving), placements

    def _place(self, placements: Mapping[int, Placement]) -> Model:
        """Place the models of moving road users in the world."""
        models = []
        for number, place in placements.items():
            model = self.road_users[number].body.model_at(place).transform(place.rotation, place.translation, number)
            model.faces["lights"] = 1
            models.append(model)
        return merge_models(models)

    @staticmethod
    def _stand_model(number: int, user: RoadUser) -> Model:
        place = user.motion.at(0.0)
        return user.body.model_at(place).transform(place.rotation, place.translation, number)

    def render(
        self,
        instant: Instant,
        lens: Lens,
        world_SE3_camera: Poses,
        *,
        response: CameraResponse = _PLAIN,
        seed: int = 0,
        drops: Records | None = None,
        twist: Twist | None = None,
    ) -> RenderedImage:
        """Render one image.

        Args:
            instant: the world at the time of the image.
            lens: rays of the camera.
            world_SE3_camera: one pose at mid-exposure.
            response: the camera's response to light.
            seed: seed of the noise.
            drops: rain drops on the lens, from `lens_drops`.
            twist: motion of the camera; None: it does not move.
        """
        surroundings = instant.surroundings
        rotation, origin = matrix_from_quaternion(world_SE3_camera.rotation)[0], world_SE3_camera.translation[0]
        view = rasterize_view(surroundings, lens, rotation, origin)
        radiance = view.radiance()
        if self.light.record["wet"] > 0.0:
            radiance = add_reflections(radiance, surroundings, lens, rotation, origin)
        return RenderedImage(self._develop(radiance, view, lens, response, seed, drops, twist), view)

    def render_lines(
        self,
        instant: Instant,
        lens: Lens,
        times_s: Float64,
        world_SE3_ego: Poses,
        world_SE3_camera: Poses,
        *,
        columns: bool,
        response: CameraResponse = _PLAIN,
        seed: int = 0,
        drops: Records | None = None,
        twist: Twist | None = None,
    ) -> RollingImage:
        """Render one image of a rolling shutter: road users, vehicle and camera are where they are at each line's time.

        Light is that of the instant: the sun, clouds, signals, headlights and the shadows of moving road users.

        Args:
            instant: the world at mid-exposure.
            lens: rays of the camera.
            times_s: (L,) time of each row, or of each column.
            world_SE3_ego: L poses of the recording vehicle.
            world_SE3_camera: L poses of the camera.
            columns: whether lines are columns.
            response: the camera's response to light.
            seed: seed of the noise.
            drops: rain drops on the lens.
            twist: motion of the camera at mid-exposure; None: images are not blurred.
        """
        rotations = matrix_from_quaternion(world_SE3_camera.rotation)

        def line_at(number: int) -> LineInstant:
            surroundings = self.surroundings_at(instant, float(times_s[number]), world_SE3_ego[number : number + 1])
            return LineInstant(surroundings, rotations[number], world_SE3_camera.translation[number])

        wet = bool(self.light.record["wet"] > 0.0)
        radiance, view = render_lines(lens, len(times_s), line_at, columns=columns, wet=wet)
        return RollingImage(self._develop(radiance, view, lens, response, seed, drops, twist), view)

    def _develop(
        self,
        radiance: Float32,
        view: RasterizedView | LinesView,
        lens: Lens,
        response: CameraResponse,
        seed: int,
        drops: Records | None,
        twist: Twist | None,
    ) -> UInt8:
        """Develop radiance (H, W, 4) to pixels."""
        effects, motion = self.condition.effects, None
        if twist is not None and effects.motion_blur:
            motion = compute_image_motion(
                lens.jacobian, view.distance_m, twist.velocity_mps, twist.turn_radps, twist.exposure_s
            )
            # The recording vehicle moves with its cameras, so it is not blurred.
            motion[view.label == Label.EGO] = 0.0
        light = np.ascontiguousarray(radiance[..., :3])
        return develop(light, self.light.record, response, effects, seed, motion=motion, drops=drops)

    def surroundings_at(self, instant: Instant, time_s: float, world_SE3_ego: Poses) -> Surroundings:
        """Return an instant's surroundings with road users and the recording vehicle where they are at a time.

        Args:
            instant: the world at mid-exposure.
            time_s: time since the start, such as that of a line of an image.
            world_SE3_ego: pose of the recording vehicle at that time.
        """
        ego, turn = world_SE3_ego.translation[0], matrix_from_quaternion(world_SE3_ego.rotation)[0]
        moving = self._place(
            {
                number: self.road_users[number].motion.at(time_s)
                for number in instant.placements
                if not _is_static(self.road_users[number])
            }
        )
        there = merge_models([moving, self._place_ego(turn, ego)])
        return instant.surroundings._replace(**self._join(there, time_s))

    def _instant(
        self, time_s: float, there: Model, moving: Model, placements: dict[int, Placement], ego: Float64, beam: Float64,
        buffer: SurfaceBuffer | None = None,
    ) -> Instant:  # fmt: skip
        static, record = self._static, self.light.at(time_s)
        maps = static.maps.copy()
        shadow = ShadowMap.none()
        if record["shadows"] and record["sunlight"].any():
            shadow = render_shadow_map(moving, np.array(record["sun"]), ego, _RENDER_RANGE_M)
        maps["moving_shadow_origin"] = shadow.origin
        occlusion, maps["ambient_occlusion_origin"] = _ambient_occlusion(
            [(self.road_users[number].body, place) for number, place in placements.items()], ego
        )
        maps["beam"] = beam
        glow, maps["glow_origin"] = _headlight_glow(
            [(self.road_users[number].body, place) for number, place in placements.items()
             if record["headlight"] > 0.0 and not _is_static(self.road_users[number])],
            ego,
        )  # fmt: skip
        joined = self._join(there, time_s, buffer)
        surroundings = Surroundings(
            joined["faces"], joined["corners"], joined["rounds"], joined["spheres"],
            static.shadow.height, shadow.height, static.lamps, glow, occlusion, static.ground,
            self.light.dome, self.light.clouds, static.layouts.view(flat(MARK)),
            record.reshape(1).view(flat(LIGHTING))[0], maps.view(flat(MAPS))[0],
        )  # fmt: skip
        return Instant(surroundings, placements)

    def _join(self, there: Model, time_s: float, buffer: SurfaceBuffer | None = None) -> dict[str, Any]:
        """Join what moves to the static model: faces, corners, rounds and spheres of `Surroundings`."""
        static, lit = self._static, self.world.find_lit_lamps(self.clock_s + time_s)
        return (buffer or SurfaceBuffer()).join(static.model, static.spheres, there, lit)


@dataclass(frozen=True, eq=False)
class _StaticScene:
    model: Model
    spheres: Float64
    shadow: ShadowMap
    lamps: Float32
    ground: Float32
    layouts: Records
    maps: Records


def _is_static(user: RoadUser) -> bool:
    return isinstance(user.motion, StaticMotion)


def _change_images(model: Model, visit: int) -> None:
    """Select the images of billboards and posters for a visit."""
    faces = model.faces
    changing = (faces["images"] > 1) & (faces["image"] != NO_IMAGE)
    faces["image"][changing] += (faces["seed"][changing] + visit) % faces["images"][changing]


def _lamp_map(lights: Float64, edge: float) -> tuple[Float32, Float64]:
    grid = np.arange(-edge, edge + LAMP_CELL_M, LAMP_CELL_M)
    light = np.zeros((len(grid), len(grid)))
    for x, y, _ in lights:
        rows = np.abs(grid - y) <= _LAMP_REACH_M
        columns = np.abs(grid - x) <= _LAMP_REACH_M
        square = (grid[columns] - x) ** 2 + (grid[rows] - y)[:, None] ** 2
        fade = np.clip(1.0 - square / _LAMP_REACH_M**2, 0.0, 1.0) ** 2
        light[np.ix_(rows, columns)] += fade * arrays.power(36.0 / (36.0 + square), 1.5)
    return light.astype(np.float32), np.array([-edge, -edge])


def _ambient_occlusion(bodies: Sequence[tuple[Body, Placement]], ego: Float64) -> tuple[Float32, Float64]:
    grid = np.arange(-_SHADOW_RANGE_M, _SHADOW_RANGE_M, AMBIENT_OCCLUSION_CELL_M)
    shade = np.zeros((len(grid), len(grid)), np.float32)
    for body, place in bodies:
        x, y = place.x_m - ego[0], place.y_m - ego[1]
        half, aside = 0.5 * body.size_m[0] - 0.1, 0.5 * body.size_m[1] - 0.1
        reach = half + 1.2
        columns = slice(*np.searchsorted(grid, (x - reach, x + reach)))
        rows = slice(*np.searchsorted(grid, (y - reach, y + reach)))
        cos, sin = scalars.cos(place.yaw_rad), scalars.sin(place.yaw_rad)
        dx, dy = grid[columns] - x, (grid[rows] - y)[:, None]
        beyond = arrays.hypot(
            np.maximum(np.abs(cos * dx + sin * dy) - half, 0.0), np.maximum(np.abs(cos * dy - sin * dx) - aside, 0.0)
        )
        shade[rows, columns] = 1.0 - (1.0 - shade[rows, columns]) * (1.0 - 0.8 * arrays.exp(-beyond / 0.22))
    return shade, ego[:2] - _SHADOW_RANGE_M


def _headlight_glow(vehicles: Sequence[tuple[Body, Placement]], ego: Float64) -> tuple[Float32, Float64]:
    """Map of the light of other vehicles' headlights on the ground; wider and weaker with distance."""
    grid = np.arange(-_SHADOW_RANGE_M - 20.0, _SHADOW_RANGE_M + 20.0, GLOW_CELL_M)
    light = np.zeros((len(grid), len(grid)), np.float32)
    for body, place in vehicles:
        if body.category not in _DRIVEN:
            continue
        cos, sin = scalars.cos(place.yaw_rad), scalars.sin(place.yaw_rad)
        x, y = place.x_m + 0.5 * body.size_m[0] * cos - ego[0], place.y_m + 0.5 * body.size_m[0] * sin - ego[1]
        columns = slice(*np.searchsorted(grid, (x - _BEAM_M, x + _BEAM_M)))
        rows = slice(*np.searchsorted(grid, (y - _BEAM_M, y + _BEAM_M)))
        dx, dy = grid[columns] - x, (grid[rows] - y)[:, None]
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        width = 0.8 + 0.22 * np.maximum(ahead, 0.0)
        near = np.clip(ahead / 3.0, 0.0, 1.0) * np.clip((_BEAM_M - ahead) / 12.0, 0.0, 1.0)
        light[rows, columns] += near * arrays.exp(-((aside / width) ** 2)) / (1.0 + 0.012 * ahead * ahead)
    return light, ego[:2] + grid[0]
