"""A street as a Gymnasium environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from hybridworldsim.simulator.ego.vehicle import Controls, VehicleParameters, curvature_of
from hybridworldsim.simulator.policies.protocol import ROUTE_POINTS, Action, CameraSpec, Observation, PlannedTrajectory
from hybridworldsim.simulator.renderers.protocol import Renderer, rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.mosaic import bird_eye, mosaic
from hybridworldsim.simulator.simulation import Simulation, start_simulation
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.street import Street
from mirror.arrays import Float32, UInt8
from mirror.errors import UsageError
from mirror.metrics.safety import StateLog
from mirror.schema.folders import FolderKind, find_kind
from mirror.schema.scenario import Scenario, read_scenario, scenario_file

if TYPE_CHECKING:
    from hybridworldsim.simulator.renderers.generated import DriveGenerator

TRAJECTORY_TIMES_S: Final = 0.5 * np.arange(1.0, 9.0)
"""Times of the poses of a trajectory action, from the observation on."""
_FASTEST_MPS: Final = 80.0
_SEED_LIMIT: Final = 2**31


class StreetEnv(gymnasium.Env[dict[str, Any], np.ndarray]):
    """Drives the ego vehicle through a scenario on a street.

    An observation is a dict of one instant: ``cameras`` (with at least one camera): (H, W, 3) uint8 RGB by name;
    ``calibration``: (11,) by name: fx fy cx cy in pixels and ``ego_SE3_camera`` as qw qx qy qz tx ty tz; ``ego``: (5,)
    speed, acceleration, steering angle, curvature, yaw rate; ``route``: (40, 2) points every 2 m in the ego frame;
    ``stamp_ns``: (1,) Unix time.

    An action is (2,) acceleration in m/s2 and curvature in 1/m, or a trajectory of 4 s: (8, 3) x, y and yaw of the rear
    axle in the ego frame every half second, which a tracker follows. The reward is the progress on the route in metres;
    a collision ends the episode.

    Args:
        street: ``synth:PRESET[:SEED[:DRIVE]]``, the folder of a dataset, or a `Street`.
        scenario: name of a scenario, path of its .toml, or a `Scenario`.
        cameras: names of the cameras; no image is rendered of others.
        renderer: ``boxes``, ``exact``, ``reconstructed`` or ``generated``; None: ``generated`` with a generator,
            ``reconstructed`` with a model, else ``boxes``.
        action: ``controls`` or ``trajectory``.
        width_px: width of the images; None: that of the rig.
        height_px: height of the images; None: in proportion.
        model: folder of the trained model, for ``reconstructed`` and ``generated``.
        generator: folder that `mirror generate train` wrote, for ``generated``; episodes run at the rate of its
            training.
        method: ``FILE.py:OBJECT`` of the model's method; None: it is installed.
        scene: scene of the dataset; None: it has only one.
        road_map: file of the map; None: exact for a synthetic street; for a dataset its recorded map, or a fitted one.
        render_mode: ``rgb_array``: `render` returns the cameras of the observation with a bird's-eye view beside them.

    Raises:
        UsageError: an argument is not valid, or the scenario does not fit on the street.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        street: str | Street = "synth:tiny",
        scenario: str | Path | Scenario = "free-traffic",
        cameras: Sequence[str] = (),
        renderer: str | None = None,
        action: Literal["controls", "trajectory"] = "controls",
        width_px: int | None = 240,
        height_px: int | None = None,
        model: str | Path | None = None,
        scene: str | None = None,
        road_map: str | Path | None = None,
        render_mode: str | None = None,
        method: str | None = None,
        generator: str | Path | None = None,
    ) -> None:
        if action not in ("controls", "trajectory"):
            raise UsageError(f"action {action!r}", expected="controls or trajectory")
        if render_mode not in (None, "rgb_array"):
            raise UsageError(f"render_mode {render_mode!r}", expected="rgb_array or None")
        map_path = None if road_map is None else Path(road_map)
        self._street = street if isinstance(street, Street) else open_street(street, scene=scene, road_map=map_path)
        self._scenario = scenario if isinstance(scenario, Scenario) else read_scenario(scenario)
        self._scenario_file = None if isinstance(scenario, Scenario) else scenario_file(scenario)
        self._cameras = rig_cameras(self._street, cameras, width_px, height_px)
        if model is not None and find_kind(Path(model)) is not FolderKind.MODEL:
            raise UsageError(
                "the folder has no model",
                file=model,
                place="model",
                expected="a folder that `mirror reconstruct` wrote",
            )
        name = renderer or ("boxes" if model is None else "reconstructed" if generator is None else "generated")
        choice = None if generator is None else _open_generator(Path(generator))
        if choice is not None:
            self._scenario = choice.at_rate(self._scenario)
        model_path = None if model is None else Path(model)
        self._factory = RendererFactory(name, model_path, method, option="method=", generator=choice)
        self._kind = action
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self._scenario.rate_hz}
        self.action_space = _action_space(action, self._street.vehicle)
        self.observation_space = _observation_space(self._cameras, self._street.vehicle)
        self._simulation: Simulation | None = None
        self._renderer: Renderer | None = None
        self._images: dict[str, UInt8] = {}
        self._progress_m = 0.0

    @property
    def simulation(self) -> Simulation:
        """The running rollout.

        Raises:
            UsageError: the environment was not reset.
        """
        if self._simulation is None:
            raise UsageError("there is no rollout yet", remedy="call reset() first")
        return self._simulation

    @property
    def state_log(self) -> StateLog:
        """The states of the episode so far."""
        return self.simulation.recorder.log()

    @property
    def rendered(self) -> int:
        """Number of images rendered in this episode."""
        return 0 if self._renderer is None else self._renderer.rendered

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seed of the episode and of the next ones; None: the next one of this environment, at first the
                scenario's.
            options: must be empty.
        """
        super().reset(seed=seed)
        if options:
            raise UsageError(f"options {sorted(options)}", expected="no options")
        first = self._simulation is None and seed is None
        chosen = self._scenario.seed if first else int(self.np_random.integers(_SEED_LIMIT))
        self._simulation = start_simulation(self._street, self._scenario, chosen, scenario_file=self._scenario_file)
        self._renderer = self._factory.make(self._simulation, self._cameras)
        self._progress_m = 0.0
        return self._observe(), self._info(None)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one step of the scenario.

        Raises:
            UsageError: the action has another shape, or a number that is not finite.
        """
        simulation = self.simulation
        ending = simulation.advance(self._to_action(np.asarray(action, np.float64)))
        before, self._progress_m = self._progress_m, simulation.progress_m()
        terminated = ending in ("collision", "route_end", "left_street")
        return (
            self._observe(),
            self._progress_m - before,
            terminated,
            ending == "duration",
            self._info(ending),
        )

    def render(self) -> UInt8 | None:
        """Return the observed images and a bird's-eye view as one image (H, W, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        simulation = self.simulation
        return mosaic(self._images, bird_eye(simulation))

    def _to_action(self, numbers: np.ndarray) -> Action:
        if numbers.shape != self.action_space.shape:
            raise UsageError(f"an action of shape {numbers.shape}", expected=f"{self.action_space.shape}")
        if not np.isfinite(numbers).all():
            raise UsageError("the action has a number that is not finite", place="action", expected="finite numbers")
        if self._kind == "trajectory":
            return PlannedTrajectory(TRAJECTORY_TIMES_S, numbers)
        return Controls(float(numbers[0]), float(numbers[1]))

    def _observe(self) -> dict[str, Any]:
        if self._renderer is None:
            raise UsageError("there is no rollout yet", remedy="call reset() first")
        self._images = dict(self._renderer.render(self.simulation.now, tuple(self._cameras)))
        return observation_dict(self.simulation.observe(self._images), self._cameras, self._street.vehicle)

    def _info(self, ending: str | None) -> dict[str, Any]:
        return {
            "ending": ending or "",
            "progress_m": self._progress_m,
            "rendered": self.rendered,
            "seed": self.simulation.seed,
        }


def _open_generator(folder: Path) -> DriveGenerator:
    from hybridworldsim.generation.commands.model_paths import find_model_files
    from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
    from hybridworldsim.simulator.renderers.generated import DriveGenerator

    return DriveGenerator(GeneratorFiles(*find_model_files(folder, None)))


def observation_dict(
    observation: Observation, cameras: dict[str, CameraSpec], vehicle: VehicleParameters
) -> dict[str, Any]:
    """Return an observation as the dict that `StreetEnv` describes."""
    ego = observation.ego
    curvature = curvature_of(vehicle, ego)
    numbers = (ego.speed_mps, ego.acceleration_mps2, ego.steering_rad, curvature, curvature * ego.speed_mps)
    plain: dict[str, Any] = {
        "ego": np.array(numbers, np.float32),
        "route": observation.route.astype(np.float32),
        "stamp_ns": np.array([observation.stamp_ns], np.int64),
    }
    if cameras:
        plain["cameras"] = {name: observation.images[name] for name in cameras}
        plain["calibration"] = {name: calibration_of(spec) for name, spec in cameras.items()}
    return plain


def calibration_of(spec: CameraSpec) -> Float32:
    """Return (11,) fx fy cx cy and ``ego_SE3_camera`` as qw qx qy qz tx ty tz."""
    camera, pose = spec.camera, spec.ego_SE3_camera
    lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return np.array([*lens, *pose.rotation[0], *pose.translation[0]], np.float32)


def _action_space(kind: str, vehicle: VehicleParameters) -> spaces.Box:
    if kind == "trajectory":
        reach = _FASTEST_MPS * TRAJECTORY_TIMES_S[-1]
        bound = np.tile(np.array([reach, reach, math.pi], np.float32), (len(TRAJECTORY_TIMES_S), 1))
        return spaces.Box(-bound, bound, dtype=np.float32)
    low = np.array([-vehicle.max_deceleration_mps2, -vehicle.max_curvature_radpm], np.float32)
    high = np.array([vehicle.max_acceleration_mps2, vehicle.max_curvature_radpm], np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def _observation_space(cameras: dict[str, CameraSpec], vehicle: VehicleParameters) -> spaces.Dict:
    bend = vehicle.max_curvature_radpm
    low = np.array(
        [0.0, -vehicle.max_deceleration_mps2, -vehicle.max_steering_rad, -bend, -bend * _FASTEST_MPS], np.float32
    )
    high = np.array(
        [np.inf, vehicle.max_acceleration_mps2, vehicle.max_steering_rad, bend, bend * _FASTEST_MPS], np.float32
    )
    # Single precision rounds the limits of the vehicle to either side.
    parts: dict[str, spaces.Space[Any]] = {
        "ego": spaces.Box(np.nextafter(low, -np.float32(np.inf)), np.nextafter(high, np.float32(np.inf))),
        "route": spaces.Box(-np.inf, np.inf, (ROUTE_POINTS, 2), np.float32),
        "stamp_ns": spaces.Box(np.iinfo(np.int64).min, np.iinfo(np.int64).max, (1,), np.int64),
    }
    if cameras:
        parts["cameras"] = spaces.Dict(
            {
                name: spaces.Box(0, 255, (spec.camera.height_px, spec.camera.width_px, 3), np.uint8)
                for name, spec in cameras.items()
            }
        )
        parts["calibration"] = spaces.Dict({name: spaces.Box(-np.inf, np.inf, (11,), np.float32) for name in cameras})
    return spaces.Dict(parts)
