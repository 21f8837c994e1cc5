"""The interface of a renderer, and what all renderers share: cameras, poses and the motion of bodies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from hybridworldsim.simulator.agents.bodies import body_of_size
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import coast
from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.rolling import fit_readout, make_shutter
from hybridworldsim.simulator.street.ground import StreetGround
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera, undistorted
from mirror.protocols.views.view import ViewShutter
from mirror.synth import Body, RoadUser
from mirror.traffic.placement.motion import Placement

if TYPE_CHECKING:
    from torch import Tensor

    from mirror.synth import Lens

_BASE_SHARE: Final = 0.6
_TRACK_SHARE: Final = 0.8


@dataclass(frozen=True, eq=False)
class CameraView:
    """A camera at a place.

    Attributes:
        name: its name.
        camera: lens and raster; a pinhole.
        world_SE3_camera: where it is at mid-exposure.
        shutter: its rolling shutter; None: all of it is seen at mid-exposure.
    """

    name: str
    camera: Camera
    world_SE3_camera: Poses
    shutter: ViewShutter | None = None


class Renderer(ABC):
    """A renderer of the street with its agents.

    Args:
        street: the street.
        cameras: the cameras of the ego vehicle, by name; pinholes.

    Attributes:
        name: name of the renderer.
        rendered: number of images rendered so far.
    """

    name: str

    def __init__(self, street: Street, cameras: Mapping[str, CameraSpec]) -> None:
        self.rendered = 0
        self._street, self._cameras = street, cameras

    def render(self, snapshot: Snapshot, cameras: Sequence[str]) -> Mapping[str, UInt8]:
        """Render images (H, W, 3), RGB, of some cameras of the ego vehicle, all at one instant."""
        return self.render_views(snapshot, self._views_of(snapshot, cameras)) if cameras else {}

    def render_tensors(self, snapshot: Snapshot, cameras: Sequence[str]) -> Mapping[str, Tensor]:
        """Render as `render` does; the images, uint8, stay on the device that made them."""
        return self.render_view_tensors(snapshot, self._views_of(snapshot, cameras)) if cameras else {}

    def render_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        """Render images (H, W, 3), RGB, of cameras anywhere, all at one instant; the cameras' names must differ."""
        self.rendered += len(views)
        return self._draw_views(snapshot, views)

    def render_view_tensors(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, Tensor]:
        """Render as `render_views` does; the images, uint8, stay on the device that made them."""
        self.rendered += len(views)
        return self._draw_tensors(snapshot, views)

    def view_counts(self) -> dict[str, int] | None:
        """Return counts of how the views so far were rendered; None if all are rendered alike."""
        return None

    def _views_of(self, snapshot: Snapshot, cameras: Sequence[str]) -> list[CameraView]:
        """Return cameras of the ego vehicle at their places.

        A camera with a rolling shutter moves during its readout as the ego does at its present acceleration and
        steering angle.
        """
        world_SE3_ego = ego_pose(self._street, snapshot)
        views = []
        for name in cameras:
            spec = self._cameras[name]
            readout, shutter = spec.readout, None
            if readout is not None:
                egos = ego_poses(self._street, snapshot, 1e-9 * np.array([readout.first_ns, readout.last_ns]))
                shutter = make_shutter(readout, egos @ spec.ego_SE3_camera)
            views.append(CameraView(name, spec.camera, world_SE3_ego @ spec.ego_SE3_camera, shutter))
        return views

    @abstractmethod
    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]: ...

    def _draw_tensors(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, Tensor]:
        """Draw images on the CPU; a renderer that computes elsewhere replaces this."""
        return to_tensors(self._draw_views(snapshot, views))


def to_tensors(images: Mapping[str, UInt8]) -> dict[str, Tensor]:
    """Return images by camera as tensors of the CPU, with the same memory."""
    import torch

    return {name: torch.from_numpy(image) for name, image in images.items()}


def to_arrays(images: Mapping[str, Tensor]) -> dict[str, UInt8]:
    """Return images by camera as arrays; those of the CPU share the memory."""
    return {name: image.cpu().numpy() for name, image in images.items()}


def rig_cameras(
    street: Street, names: Sequence[str], width_px: int | None, height_px: int | None = None
) -> dict[str, CameraSpec]:
    """Return the cameras of a street's rig as pinholes of one size.

    Args:
        street: the street.
        names: names of the cameras.
        width_px: width of the images; None: the size of the recorded images.
        height_px: height of the images; None: in proportion.

    Raises:
        UsageError: the rig has no camera of a name, or the size is not positive.
    """
    for side, size in (("width", width_px), ("height", height_px)):
        if size is not None and size < 1:
            raise UsageError(f"images with a {side} of {size} px", place=side, expected="at least 1 px")
    specs = {}
    for name in names:
        if name not in street.rig:
            raise UsageError(f"the rig has no camera {name!r}", expected=f"one of {', '.join(street.rig)}")
        member = street.rig[name]
        camera = undistorted(member.camera)
        if width_px is not None:
            height = height_px or max(round(camera.height_px * width_px / camera.width_px), 1)
            camera = camera.resized(width_px, height)
        readout = fit_readout(member.camera, member.shutter, camera)
        specs[name] = CameraSpec(camera, member.ego_SE3_camera, readout)
    return specs


@lru_cache(maxsize=64)
def lens_of(camera: Camera) -> Lens:
    """Return the rays of a camera; the rays of recently used cameras are cached."""
    from mirror.synth import make_lens

    return make_lens(camera)


def ego_pose(street: Street, snapshot: Snapshot) -> Poses:
    """Return ``world_SE3_ego`` of the ego on the ground."""
    ego, vehicle = snapshot.ego, snapshot.vehicle
    return street.ground.world_SE3_ego(
        ego.x_m, ego.y_m, ego.yaw_rad, vehicle.wheelbase_m, _TRACK_SHARE * vehicle.width_m
    )


def ego_poses(street: Street, snapshot: Snapshot, offsets_s: Float64) -> Poses:
    """Return ``world_SE3_ego`` of the ego at times (N,) from an instant, from its motion then."""
    poses = [
        ego_pose(street, replace(snapshot, ego=coast(snapshot.vehicle, snapshot.ego, float(offset))))
        for offset in offsets_s
    ]
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )


_FAR_M: Final = 1e6
_ABSENT: Final = Placement(_FAR_M, _FAR_M, 0.0, 0.0)


@dataclass(eq=False)
class LiveMotion:
    """The motion of an agent's body: its present placement and velocity, which `LiveUsers.update` sets.

    Attributes:
        placement: the placement; far away while the agent is absent.
        velocity_mps: velocity along x and y in the world.
        time_s: time of the placement.
    """

    placement: Placement = _ABSENT
    velocity_mps: tuple[float, float] = (0.0, 0.0)
    time_s: float = 0.0

    def at(self, time_s: float) -> Placement:
        """Return the placement at a time beside the present one, such as that of a line of an image."""
        place, (x, y), later_s = self.placement, self.velocity_mps, time_s - self.time_s
        if later_s == 0.0 or place is _ABSENT:
            return place
        along = place.along_m + later_s * place.speed_mps
        return replace(place, x_m=place.x_m + later_s * x, y_m=place.y_m + later_s * y, along_m=along)


class LiveUsers:
    """The agents as road users of the synthetic street: one object for a rollout, whose motions read live states.

    Args:
        agents: the agents.
        ground: the ground on which they stand.
    """

    def __init__(self, agents: Sequence[Agent], ground: StreetGround) -> None:
        self._ground = ground
        self.motions = [LiveMotion() for _ in agents]
        bodies = [body_of(agent) for agent in agents]
        self.users = tuple(
            RoadUser(agent.agent_id, body, motion)
            for agent, body, motion in zip(agents, bodies, self.motions, strict=True)
        )

    def update(self, snapshot: Snapshot) -> None:
        """Move all bodies to their places at an instant."""
        states = snapshot.states
        for motion in self.motions:
            motion.placement = _ABSENT
        rows = np.flatnonzero(states.present)
        if not len(rows):
            return
        sizes = np.array([snapshot.agents[row].size_m[:2] for row in rows])
        places = self._ground.places(
            states.x_m[rows],
            states.y_m[rows],
            states.yaw_rad[rows],
            _BASE_SHARE * sizes[:, 0],
            _TRACK_SHARE * sizes[:, 1],
        )
        speeds = np.hypot(states.vx_mps, states.vy_mps)
        for row, place in zip(rows.tolist(), places, strict=True):
            self.motions[row].placement = replace(
                place, speed_mps=float(speeds[row]), along_m=float(states.along_m[row])
            )
            self.motions[row].velocity_mps = float(states.vx_mps[row]), float(states.vy_mps[row])
            self.motions[row].time_s = snapshot.time_s


def body_of(agent: Agent) -> Body:
    """Return the body of an agent."""
    if agent.body is not None:
        return agent.body
    length, width, height = (round(size, 2) for size in agent.size_m)
    return body_of_size(agent.category, (length, width, height))
