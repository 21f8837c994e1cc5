"""Images of nearby people and cars in the synthetic street, with the exact positions of faces and plates."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int32, UInt8
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.schema.documents import Roi
from mirror.synth.light.condition import Condition
from mirror.synth.light.sun import instant_of
from mirror.synth.model import FACE, ROUND
from mirror.synth.render.rendering import render
from mirror.synth.render.view import RasterizedView
from mirror.synth.road_users.body import RoadUser
from mirror.synth.road_users.cars import build_car
from mirror.synth.road_users.people import draw_pedestrian
from mirror.synth.street.world import World, build_world
from mirror.synth.textures.catalogue import FACES, PLATES
from mirror.traffic.placement.motion import Placement, StaticMotion

_PLACE: Final = (8.41694, 49.01252)
_VIEW_DEG: Final = 70.0
_EYE_M: Final = 1.6
_CLEAR_M: Final = 22.0
PEOPLE: Final = (8, 1)
CARS: Final = (1, 6)
"""Numbers in images with even index, and in images with odd index."""
CARS_M: Final = (4.5, 24.0)
"""Distances of the nearest and the farthest car."""
_TRIALS: Final = 20
_EGO_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_BROW_AND_CHIN: Final = (0.55, -0.95)


@dataclass(frozen=True, eq=False)
class Target:
    """An object that a detector may find.

    Attributes:
        box_px: (4,) ``u_min v_min u_max v_max`` of the whole object.
        seen: share of the object that the image shows; parts that face away do not count as shown.
    """

    box_px: Float64
    seen: float

    @property
    def size_px(self) -> Float64:
        """Width and height (2,)."""
        return self.box_px[2:] - self.box_px[:2]


@dataclass(frozen=True, eq=False)
class CrowdImage:
    """An image with its targets.

    Attributes:
        bgr: (H, W, 3) pixels.
        faces: faces of people.
        plates: plates of cars.
        camera: the camera.
        world_SE3_camera: its pose.
        road_users: the road users of the image, parked ones included.
    """

    bgr: UInt8
    faces: list[Target]
    plates: list[Target]
    camera: Camera
    world_SE3_camera: Poses
    road_users: list[RoadUser]


def build_street() -> World:
    """Build an urban scene."""
    roi = Roi(
        scene_id="crowd", longitude_deg=_PLACE[0], latitude_deg=_PLACE[1], radius_m=100.0, city="Karlsruhe",
        scene_type="urban", height_m=115.0,
    )  # fmt: skip
    return build_world(roi, 24.0, 3)


def render_crowds(
    world: World,
    condition: Condition,
    count: int,
    width_px: int,
    seed: int,
    *,
    people: tuple[int, int] = PEOPLE,
    cars: tuple[int, int] = CARS,
    cars_m: tuple[float, float] = CARS_M,
    left_out: Container[int] = (),
) -> Iterator[CrowdImage]:
    """Yield images along the street, alternately of people and of cars, facing the camera; some cars face away.

    Args:
        world: the street.
        condition: light and weather.
        count: number of images.
        width_px: width of an image.
        seed: seed of positions and appearance.
        people: numbers of people in images with even and odd index.
        cars: numbers of cars likewise.
        cars_m: distances of the nearest and the farthest car.
        left_out: indices of images that are not made; the others stay the same.
    """
    height = width_px * 9 // 16
    focal = 0.5 * width_px / math.tan(math.radians(0.5 * _VIEW_DEG))
    camera = Camera("pinhole", width_px, height, focal, focal, 0.5 * width_px, 0.5 * height)
    lanes = [lane for lane in world.network.lanes.values() if lane.use == "drive" and lane.length_m > 60.0]
    for number in (number for number in range(count) if number not in left_out):
        rng = np.random.default_rng([seed, number])
        lane = lanes[int(rng.integers(len(lanes)))]
        at = int(rng.uniform(0.1, 0.6) * len(lane.line))
        ahead = lane.line[at + 1] - lane.line[at]
        course = math.atan2(ahead[1], ahead[0])
        pose = _pose(lane.line[at] + (0.0, 0.0, _EYE_M), course)
        road_users = [
            user
            for user in world.parked
            if math.dist((user.motion.at(0.0).x_m, user.motion.at(0.0).y_m), lane.line[at, :2]) > _CLEAR_M
        ]
        road_users += _place_road_users(world, lane.line[at], course, people[number % 2], cars[number % 2], cars_m, rng)
        image = render(world, pose, camera, 0.0, condition, road_users=road_users, seed=number)
        faces, plates = _faces(image.view, camera, pose), _plates(image.view, camera, pose)
        yield CrowdImage(image.bgr, faces, plates, camera, pose, road_users)


def make_condition(light: str, weather: str) -> Condition:
    """Return a condition with this light and weather."""
    return Condition(instant_of("2025-09-16", light, *_PLACE), light, weather)  # type: ignore[arg-type]


def _pose(place: Float64, course: float) -> Poses:
    cos, sin = math.cos(course), math.sin(course)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Poses(quaternion_from_matrix((turn @ _EGO_R_CAMERA)[None]), place[None])


def _place_road_users(
    world: World,
    origin: Float64,
    course: float,
    people: int,
    cars: int,
    cars_m: tuple[float, float],
    rng: np.random.Generator,
) -> list[RoadUser]:
    """Place cars and people in front of the camera without overlaps."""
    road_users: list[RoadUser] = []
    occupied: list[tuple[float, float, float]] = []
    for number in range(people + cars):
        is_car = number >= people
        nearest, farthest, radius = (*cars_m, 2.3) if is_car else (1.7, 14.0, 0.5)
        for _ in range(_TRIALS):
            distance = math.exp(rng.uniform(math.log(nearest), math.log(farthest)))
            bearing = course + math.radians(rng.uniform(-0.42, 0.42) * _VIEW_DEG)
            x, y = origin[0] + distance * math.cos(bearing), origin[1] + distance * math.sin(bearing)
            if all(math.dist((x, y), other[:2]) > radius + other[2] for other in occupied):
                break
        else:
            continue
        occupied.append((x, y, radius))
        body = build_car(rng) if is_car else draw_pedestrian(rng, child=rng.random() < 0.15, warm=rng.random() < 0.5)
        back = is_car and rng.random() < 0.5
        yaw = bearing + (0.0 if back else math.pi) + math.radians(rng.uniform(-50.0, 50.0))
        place = Placement(x, y, float(world.height_m(x, y)), yaw)
        road_users.append(RoadUser(f"{body.category}-{number}", body, StaticMotion(place)))
    return road_users


def _faces(view: RasterizedView, camera: Camera, pose: Poses) -> list[Target]:
    """Targets of faces: the front half of each head, from the chin to the brow."""
    rounds = view.scene.rounds.view(ROUND)
    high, low = _BROW_AND_CHIN
    y, z = np.meshgrid(np.linspace(-0.9, 0.9, 13), np.linspace(low, high, 15))
    inside = y**2 + z**2 < 0.95
    front = np.stack([np.sqrt(1.0 - y[inside] ** 2 - z[inside] ** 2), y[inside], z[inside]], axis=1)
    targets = []
    for index in np.flatnonzero(np.isin(rounds["image"], FACES)):
        head = rounds[index]
        points = head["centre"] + (front * head["half"]) @ head["axes"]
        targets.append(_target(view.surface, len(view.scene.faces) + int(index), points, camera, pose))
    return [target for target in targets if target is not None]


def _plates(view: RasterizedView, camera: Camera, pose: Poses) -> list[Target]:
    """Targets of number plates."""
    faces = view.scene.faces.view(FACE)
    along, up = (
        values.ravel()[:, None] for values in np.meshgrid(np.linspace(0.02, 0.98, 15), np.linspace(0.05, 0.95, 5))
    )
    targets = []
    for index in np.flatnonzero(np.isin(faces["image"], PLATES)):
        a, b, c, d = view.scene.corners[faces["first"][index] :][:4]
        points = (1 - up) * ((1 - along) * a + along * b) + up * ((1 - along) * d + along * c)
        targets.append(_target(view.surface, int(index), points, camera, pose))
    return [target for target in targets if target is not None]


def _target(surface: Int32, index: int, points: Float64, camera: Camera, pose: Poses) -> Target | None:
    """The target of points (N, 3) on a surface; None if none of them is visible."""
    images = camera.project(pose.inverse().transform(points)[0])
    if not images.defined.all():
        return None
    column, row = np.floor(images.uv_px[images.valid]).astype(int).T
    shown = np.count_nonzero(surface[row, column] == index)
    if not shown:
        return None
    box = np.concatenate([images.uv_px.min(axis=0), images.uv_px.max(axis=0)])
    return Target(box, shown / len(points))
