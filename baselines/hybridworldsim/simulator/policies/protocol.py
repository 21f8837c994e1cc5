"""The interface of a policy: what it observes, and what it answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal, Protocol, TypeAlias, cast, get_args

import numpy as np

from hybridworldsim.simulator.ego.trajectory import Trajectory
from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters
from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.protocols.views.view import RollingDirection

if TYPE_CHECKING:
    from torch import Tensor

ImageForm: TypeAlias = Literal["numpy", "torch"]
"""The form of the images that a policy gets: arrays, or tensors on the device of the renderer."""

ROUTE_STEP_M: Final = 2.0
ROUTE_POINTS: Final = 40


class LateError(UsageError):
    """A policy did not answer within its deadline."""


@dataclass(frozen=True)
class Readout:
    """The rolling shutter of a camera's raster.

    Attributes:
        direction: direction in which rows or columns are exposed.
        first_ns: time of the line that is exposed first, from the instant of the observation.
        last_ns: time of the line that is exposed last.
    """

    direction: RollingDirection
    first_ns: float
    last_ns: float


@dataclass(frozen=True, eq=False)
class CameraSpec:
    """A camera whose images a policy gets.

    Attributes:
        camera: lens and raster.
        ego_SE3_camera: mounting on the vehicle.
        readout: its rolling shutter; None: all of an image is seen at the instant of the observation, or an AlpaSim
            runtime renders it, whose messages state no readout.
    """

    camera: Camera
    ego_SE3_camera: Poses
    readout: Readout | None = None


@dataclass(frozen=True, eq=False)
class ObservationSpec:
    """The constant facts of a rollout, which a policy gets at its start.

    Attributes:
        cameras: the cameras, by name.
        vehicle: the ego vehicle.
        step_s: time between observations.
        seed: seed of the rollout.
    """

    cameras: Mapping[str, CameraSpec]
    vehicle: VehicleParameters
    step_s: float
    seed: int = 0


@dataclass(frozen=True, eq=False)
class PrivilegedState:
    """The exact state of the world, meant for reference policies.

    Attributes:
        time_s: time since the start.
        ego: the ego in the world.
        boxes: (M, 7) x, y, yaw, forward speed, half length, half width, presence; the ego is the first.
        route_m: (K, 2) points of the ego's route in the world, every half metre, from its beginning.
        route_pace_mps: (K,) speed that the route allows.
        stop_m: length along the route of the next stop line that is closed; infinite: there is none.
        recorded: recorded trajectory of the ego, in the world and in times since the start.
    """

    time_s: float
    ego: EgoState
    boxes: Float64
    route_m: Float64
    route_pace_mps: Float64
    stop_m: float
    recorded: Trajectory | None


@dataclass(frozen=True, eq=False)
class Observation:
    """An observation of a policy at one instant: images, ego state and route.

    Attributes:
        stamp_ns: Unix time.
        images: (H, W, 3) RGB by camera, at that instant; a rolling shutter exposes its lines about it.
            Empty for a `TensorPolicy`.
        ego: the ego in its own frame: x, y and yaw are 0.
        route: (`ROUTE_POINTS`, 2) points of the route every `ROUTE_STEP_M`, from the place beside the ego on, in the
            ego frame.
        odometry: (3,) x, y and yaw of the ego in its own frame at the start of the rollout.
        privileged: the exact state; None for policies that do not ask for it.
        tensors: for a `TensorPolicy` the images (H, W, 3), uint8, on the device that rendered them; else empty.
    """

    stamp_ns: int
    images: Mapping[str, UInt8]
    ego: EgoState
    route: Float64
    odometry: Float64
    privileged: PrivilegedState | None = field(default=None, repr=False)
    tensors: Mapping[str, Tensor] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, eq=False)
class PlannedTrajectory:
    """Poses of the rear axle in the ego frame at times from the observation on; the first step starts at 0 s.

    Attributes:
        times_s: (N,) increasing times above 0, N of 1 or more.
        poses: (N, 3) x, y and yaw.
    """

    times_s: Float64
    poses: Float64

    def in_world(self, ego: EgoState, time_s: float) -> Trajectory:
        """Return the trajectory in the world, with times of the rollout, beginning at the ego.

        Raises:
            UsageError: the shapes do not fit, or a number is not finite.
        """
        times, poses = np.asarray(self.times_s, np.float64), np.asarray(self.poses, np.float64)
        if times.ndim != 1 or poses.shape != (len(times), 3) or not len(times):
            raise UsageError(
                f"times of shape {times.shape} with poses of shape {poses.shape}", place="action",
                expected="(N,) and (N, 3)",
            )  # fmt: skip
        cos, sin = np.cos(ego.yaw_rad), np.sin(ego.yaw_rad)
        x = ego.x_m + cos * poses[:, 0] - sin * poses[:, 1]
        y = ego.y_m + sin * poses[:, 0] + cos * poses[:, 1]
        world = np.column_stack([x, y, ego.yaw_rad + poses[:, 2]])
        start = np.array([[ego.x_m, ego.y_m, ego.yaw_rad]])
        return Trajectory(np.concatenate([[time_s], time_s + times]), np.concatenate([start, world]))


@dataclass(frozen=True)
class NoPlanYet:
    """The policy needs more observations; until then the ego follows the recording, or its route at constant speed."""


Action: TypeAlias = Controls | PlannedTrajectory | NoPlanYet | None
"""Controls; a trajectory, which the tracker follows until another action comes; None: continue with the last action."""


class Policy(Protocol):
    """The algorithm that drives the ego vehicle.

    Attributes:
        cameras: names of the cameras whose images it reads; others are not rendered.
        privileged: whether it reads the exact state.
    """

    cameras: tuple[str, ...]
    privileged: bool

    def reset(self, spec: ObservationSpec) -> None:
        """Prepare for a new rollout."""
        ...

    def act(self, observation: Observation) -> Action:
        """Return the action of the step that begins at an observation."""
        ...

    def close(self) -> None:
        """Release the policy's processes and devices."""
        ...


class TensorPolicy(Policy, Protocol):
    """A policy that states the form in which it gets images; one that states none gets arrays.

    Attributes:
        image_form: ``numpy``, or ``torch`` for `Observation.tensors`.
    """

    image_form: ImageForm


def image_form(policy: Policy, name: str) -> ImageForm:
    """Return the form in which a policy gets images.

    Args:
        policy: the policy.
        name: its name, for messages.

    Raises:
        UsageError: it states another form.
    """
    stated = getattr(policy, "image_form", "numpy")
    if stated not in get_args(ImageForm):
        raise UsageError(
            f"image_form is {stated!r}", place=f"policy {name!r}", expected=f"one of {', '.join(get_args(ImageForm))}"
        )
    return cast(ImageForm, stated)
