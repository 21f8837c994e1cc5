"""Any view of a world, at any time, in any light: the truth that novel views are held against."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.light.condition import Condition
from mirror.synth.model import Model
from mirror.synth.render.develop.look import CameraLook
from mirror.synth.render.lens import Lens, make_lens
from mirror.synth.render.scene import Picture, Scene
from mirror.synth.street.world import World
from mirror.synth.users.body import RoadUser

_PLAIN = CameraLook()


def render(
    world: World,
    world_SE3_camera: Poses,
    camera: Camera,
    time_s: float,
    condition: Condition,
    *,
    users: Sequence[RoadUser] | None = None,
    look: CameraLook = _PLAIN,
    seed: int = 0,
) -> Picture:
    """Render a view of a world.

    Move the pose for novel trajectories, the condition for another light, the users' motions for other traffic. What
    one condition's views share (shadows, leaves) is made at the first of them and kept for the next.

    Args:
        world: what stands still, from `build_world`.
        world_SE3_camera: one pose.
        camera: the lens; every pixel has a ray.
        time_s: after the condition's start: moves clouds, signals and users.
        condition: light and weather.
        users: who else is there; default: the parked vehicles.
        look: how the camera develops.
        seed: of the noise.

    Returns:
        The picture, and the truth of its pixels in ``view``.

    Raises:
        UsageError: the camera has a pixel that nothing is imaged at.
    """
    scene = _scene(world, condition, tuple(world.parked if users is None else users))
    instant = scene.around(time_s, world_SE3_camera.translation[0])
    return scene.picture(instant, _lens(camera), world_SE3_camera, look=look, seed=seed)


@lru_cache(maxsize=4)
def _scene(world: World, condition: Condition, users: tuple[RoadUser, ...]) -> Scene:
    return Scene(world, condition, users, Model.empty())


@lru_cache(maxsize=16)
def _lens(camera: Camera) -> Lens:
    return make_lens(camera)
