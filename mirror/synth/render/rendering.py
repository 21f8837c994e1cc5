"""Renders any view of a world at any time and in any light: the ground truth of novel views."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.light.condition import Condition
from mirror.synth.model import Model
from mirror.synth.render.develop.camera_response import CameraResponse
from mirror.synth.render.lens import Lens, make_lens
from mirror.synth.render.scene import RenderedImage, Scene
from mirror.synth.road_users.body import RoadUser
from mirror.synth.street.world import World

_PLAIN = CameraResponse()


def render(
    world: World,
    world_SE3_camera: Poses,
    camera: Camera,
    time_s: float,
    condition: Condition,
    *,
    road_users: Sequence[RoadUser] | None = None,
    response: CameraResponse = _PLAIN,
    seed: int = 0,
) -> RenderedImage:
    """Render a view of a world.

    Change the pose for a novel trajectory, the condition for another light, and the road users for other traffic. The
    first view of a condition computes its shadows and leaves; later views reuse them.

    Args:
        world: the static world, from `build_world`.
        world_SE3_camera: one pose of the camera.
        camera: the camera; every pixel has a ray.
        time_s: seconds after the condition's start; sets clouds, traffic lights and road users.
        condition: light and weather.
        road_users: other road users; default: the parked vehicles of the world.
        response: the camera's response to light.
        seed: seed of the noise.

    Returns:
        The image, and the ground truth of its pixels in ``view``.

    Raises:
        UsageError: the camera has a pixel without a ray.
    """
    scene = _scene(world, condition, tuple(world.parked if road_users is None else road_users))
    instant = scene.around(time_s, world_SE3_camera.translation[0])
    return scene.render(instant, _lens(camera), world_SE3_camera, response=response, seed=seed)


@lru_cache(maxsize=4)
def _scene(world: World, condition: Condition, road_users: tuple[RoadUser, ...]) -> Scene:
    return Scene(world, condition, road_users, Model.empty())


@lru_cache(maxsize=16)
def _lens(camera: Camera) -> Lens:
    return make_lens(camera)
