"""Any view of a world, at any time, in any light: the truth that novel views are held against."""

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

    Move the pose for novel trajectories, the condition for another light, the users' motions for other traffic. What
    one condition's views share (shadows, leaves) is made at the first of them and kept for the next.

    Args:
        world: what stands still, from `build_world`.
        world_SE3_camera: one pose.
        camera: the lens; every pixel has a ray.
        time_s: after the condition's start: moves clouds, signals and users.
        condition: light and weather.
        road_users: other road users; default: the parked vehicles of the world.
        response: the camera's response to light.
        seed: of the noise.

    Returns:
        The image, and the truth of its pixels in ``view``.

    Raises:
        UsageError: the camera has a pixel that nothing is imaged at.
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
