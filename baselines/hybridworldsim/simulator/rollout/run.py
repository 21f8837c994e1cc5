"""A rollout with a policy, written to a folder: states, scenario, map, controls and video; `run.json` comes last."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import CameraSpec, Observation, Policy, image_form
from hybridworldsim.simulator.renderers.protocol import Renderer, to_arrays
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, write_actions
from hybridworldsim.simulator.rollout.curves import list_curves
from hybridworldsim.simulator.rollout.deadline import DeadlineError, PolicyError, PolicyRunner
from hybridworldsim.simulator.rollout.faulty_sensors import FaultySensors
from hybridworldsim.simulator.rollout.mosaic import bird_eye, mosaic
from hybridworldsim.simulator.rollout.page import PAGE_FILE, DrivePageContent, write_page
from hybridworldsim.simulator.simulation import Simulation, start_simulation
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import EGO, Snapshot, wrap_angles
from mirror.arrays import UInt8
from mirror.errors import MirrorError, UsageError
from mirror.metrics.safety import StateLogWriter
from mirror.metrics.safety.report import SafetyReport, score_rollout
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.sensor_faults import SensorFault
from mirror.schema.files import write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.road_map import write_road_map
from mirror.schema.rollout import (
    MAP_FILE,
    ROLLOUT,
    SCENARIO_FILE,
    STATES_FILE,
    Ending,
    MapSource,
    Rollout,
    list_files,
)
from mirror.schema.scenario import Scenario, write_scenario
from mirror.version import __version__
from mirror.view.video import write_video

VIDEO_FILE: Final = "video.mp4"
_DRIVING: Final = ".driving"
_PACKAGES: Final = ("numpy", "scipy", "numba")


@dataclass(frozen=True, eq=False)
class RolloutRequest:
    """The request to drive a scenario.

    Attributes:
        street: the street.
        scenario: the scenario.
        policy: the policy.
        policy_name: its name.
        cameras: cameras that the policy and the video may show, by name.
        factory: makes the renderer.
        seed: seed of the rollout; None: that of the scenario.
        video: names of the cameras in the video; empty: there is no video.
        deadline_s: time for an action of the policy.
        dataset_hash: hash of the dataset that was driven in.
        model_hash: hash of the model that renders.
        page: write a page with the video, curves over its time and the figures of the safety.
        ends_off_road: whether the drive ends where the whole body of the ego is off the drivable area.
        sensors: the fault of the sensors; None: they have none.
        scenario_file: file of the scenario, which errors name; None: it is of no file.
        begins_with: controls of the first steps, in which the policy observes and does not steer.
    """

    street: Street
    scenario: Scenario
    policy: Policy
    policy_name: str
    cameras: Mapping[str, CameraSpec]
    factory: RendererFactory
    seed: int | None = None
    video: tuple[str, ...] = ()
    deadline_s: float = math.inf
    dataset_hash: str | None = None
    model_hash: str | None = None
    page: bool = False
    ends_off_road: bool = False
    sensors: SensorFault | None = None
    scenario_file: str | None = None
    begins_with: Sequence[Controls] = ()


@dataclass(frozen=True, eq=False)
class RolloutResult:
    """The result of a rollout.

    Attributes:
        folder: its folder.
        rollout: its document.
        safety: its safety.
        rendered: number of images rendered.
        error: why the policy ended the rollout; None: it did not.
    """

    folder: Path
    rollout: Rollout
    safety: SafetyReport
    rendered: int
    error: MirrorError | None


def require_new_rollout(out: Path) -> FolderKind | None:
    """Require a folder that a rollout can be written to: new, empty, or of an interrupted rollout.

    Returns:
        The kind of an existing folder; None: it is absent or empty.

    Raises:
        UsageError: it has other contents, or cannot be written.
    """
    kind = require_output_folder(out, FolderKind.ROLLOUT)
    if kind is not None and (out / ROLLOUT).exists():
        raise UsageError(
            "there is a complete rollout: nothing was written", file=out, place="--out", expected="a new folder",
            remedy="name another folder, or remove this one",
        )  # fmt: skip
    return kind


def remove_mark(out: Path) -> None:
    """Remove the mark of a running drive from a complete rollout, whose command was killed before it did so."""
    (out / _DRIVING).unlink(missing_ok=True)


def run_rollout(request: RolloutRequest, out: Path, reporter: ProgressReporter | None = None) -> RolloutResult:
    """Drive a rollout and write its folder.

    A policy that fails ends the rollout: the folder is complete up to there, and the result has the error. What an
    interrupted call left in the folder is replaced.

    Args:
        request: what is driven.
        out: a new or empty folder, or that of an interrupted rollout.
        reporter: receives the progress.

    Raises:
        UsageError: the folder has other contents, the scenario does not fit on the street, or a camera is unknown.
        DatasetError: the folder cannot be written.
    """
    kind = require_new_rollout(out)
    needed = dict.fromkeys((*request.policy.cameras, *request.video))
    missing = next((name for name in needed if name not in request.cameras), None)
    if missing is not None:
        raise UsageError(
            f"policy {request.policy_name!r} needs camera {missing!r}", expected=f"one of {', '.join(request.cameras)}"
        )
    in_tensors = image_form(request.policy, request.policy_name) == "torch"
    request.factory.require_model_of(request.street)
    simulation = start_simulation(
        request.street, request.scenario, request.seed, ends_off_road=request.ends_off_road,
        scenario_file=request.scenario_file,
    )  # fmt: skip
    sensors = FaultySensors(request.sensors, simulation.seed)
    renderer = request.factory.make(simulation, sensors.turn(request.cameras)) if needed else None
    drive = _Drive(request, simulation, renderer, sensors, tuple(needed), reporter or NullProgress(), in_tensors)
    if kind is not None:
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / _DRIVING).touch()
    write_scenario(out / SCENARIO_FILE, request.scenario.model_copy(update={"seed": simulation.seed}))
    write_road_map(out / MAP_FILE, request.street.road_map)
    signals = tuple(simulation.now.signals)
    with StateLogWriter(
        out / STATES_FILE, rear_axle_to_center_m=request.street.vehicle.rear_axle_to_center_m, signals=signals
    ) as log:
        frames = drive.frames(log)
        if request.video:
            write_video(out / VIDEO_FILE, frames, request.scenario.rate_hz)
        else:
            for _ in frames:
                pass
    write_actions(out / ACTIONS_FILE, drive.actions)
    route = simulation.route.way.points
    states = simulation.recorder.log()
    safety = score_rollout(states, request.street.road_map, route)
    if request.page:
        egos = [shot.ego for shot in simulation.recorder.snapshots]
        content = DrivePageContent(
            request.scenario,
            request.policy_name,
            request.factory.name,
            [*describe_safety(safety), describe_map(request.street.map_source)],
            safety,
            states.stamps_ns.tolist(),
            list_curves(states, egos, request.street.road_map),
            out / VIDEO_FILE if request.video else None,
        )
        write_page(out / PAGE_FILE, content)
    rollout = _document(request, simulation, drive, out)
    write_json(out / ROLLOUT, rollout)
    (out / _DRIVING).unlink()
    rendered = 0 if renderer is None else renderer.rendered
    return RolloutResult(out, rollout, safety, rendered, drive.error)


class _Drive:
    """A running rollout, which yields a frame of the video for each instant."""

    def __init__(
        self,
        request: RolloutRequest,
        simulation: Simulation,
        renderer: Renderer | None,
        sensors: FaultySensors,
        cameras: Sequence[str],
        reporter: ProgressReporter,
        in_tensors: bool = False,
    ) -> None:
        self._in_tensors = in_tensors
        self._request, self._simulation, self.renderer = request, simulation, renderer
        self._cameras, self._reporter, self._sensors = tuple(cameras), reporter, sensors
        self.actions: list[Controls] = []
        self.ending: Ending = "interrupted"
        self.error: MirrorError | None = None

    def frames(self, log: StateLogWriter) -> Iterator[UInt8]:
        request, simulation = self._request, self._simulation
        runner = PolicyRunner(request.policy, request.policy_name, request.deadline_s)
        specs = {name: request.cameras[name] for name in request.policy.cameras}
        self._reporter.start("drive", request.scenario.steps)
        ending = None
        try:
            while True:
                append_states(log, request.street, simulation.now)
                shown, observe = self._render()
                if request.video:
                    yield mosaic(shown, bird_eye(simulation))
                if ending is not None:
                    self.ending = ending
                    break
                if simulation.now.step == 0:
                    runner.reset(simulation.observation_spec(specs))
                action = runner.act(observe())
                step = simulation.now.step
                instead = request.begins_with[step] if step < len(request.begins_with) else None
                try:
                    ending = simulation.advance(action, instead=instead)
                except UsageError as error:
                    raise PolicyError(
                        error.problem, place=f"policy {request.policy_name!r}, step {simulation.now.step}",
                        expected=error.expected,
                    ) from error  # fmt: skip
                self.actions.append(simulation.controls)
                self._reporter.advance(1)
        except PolicyError as error:
            self.error, self.ending = error, "deadline" if isinstance(error, DeadlineError) else "policy"
        finally:
            try:
                runner.close()
            except PolicyError as error:
                # What failed first is the reason.
                if self.error is None:
                    self.error, self.ending = error, "policy"

    def _render(self) -> tuple[dict[str, UInt8], Callable[[], Observation]]:
        """Render the present state: the images of the video, and a function that returns the policy's observation."""
        simulation, policy, video = self._simulation, self._request.policy, self._request.video
        now, privileged = simulation.now, policy.privileged
        if self.renderer is not None and self._in_tensors:
            tensors = self.renderer.render_tensors(now, self._cameras)
            own = {name: tensors[name] for name in policy.cameras}
            return to_arrays({name: tensors[name] for name in video}), lambda: simulation.observe(
                {}, privileged=privileged, tensors=self._sensors.change_tensors(own, now.step, now.time_s)
            )
        images = {} if self.renderer is None else self.renderer.render(now, self._cameras)
        sound = {name: images[name] for name in policy.cameras}
        return {name: images[name] for name in video}, lambda: simulation.observe(
            self._sensors.change(sound, now.step, now.time_s), privileged=privileged
        )


def append_states(log: StateLogWriter, street: Street, snapshot: Snapshot) -> None:
    """Append the states of all present actors at an instant to a log."""
    boxes, states = snapshot.boxes().states, snapshot.states
    rows = np.flatnonzero(boxes[:, 6])
    agents = [snapshot.agents[row - 1] for row in rows[1:]]
    from hybridworldsim.simulator.ego.vehicle import center_velocity

    vx, vy = center_velocity(snapshot.vehicle, snapshot.ego)
    unknown = np.full(len(rows), np.nan)
    acceleration, steering = unknown.copy(), unknown.copy()
    acceleration[0], steering[0] = snapshot.ego.acceleration_mps2, snapshot.ego.steering_rad
    columns = {
        "x_m": boxes[rows, 0],
        "y_m": boxes[rows, 1],
        "z_m": np.asarray(street.ground.height_m(boxes[rows, 0], boxes[rows, 1])),
        "yaw_rad": wrap_angles(boxes[rows, 2]),
        "vx_mps": np.concatenate([[vx], states.vx_mps[rows[1:] - 1]]),
        "vy_mps": np.concatenate([[vy], states.vy_mps[rows[1:] - 1]]),
        "length_m": 2.0 * boxes[rows, 4],
        "width_m": 2.0 * boxes[rows, 5],
        "height_m": np.array([snapshot.vehicle.height_m, *(agent.size_m[2] for agent in agents)]),
        "acceleration_mps2": acceleration,
        "steering_rad": steering,
    }
    log.append(
        snapshot.stamp_ns,
        [EGO, *(agent.agent_id for agent in agents)],
        [EGO, *(agent.category for agent in agents)],
        columns,
        list(snapshot.signals.values()),
    )


def _document(request: RolloutRequest, simulation: Simulation, drive: _Drive, out: Path) -> Rollout:
    versions = {"mirror": __version__, **_list_package_versions()}
    threads = None
    if request.video or request.policy.cameras:
        threads = 1
        if request.factory.name in ("reconstructed", "generated"):
            import torch

            threads, versions["torch"] = torch.get_num_threads(), torch.__version__
    return Rollout(
        scene_id=request.street.scene_id,
        scenario=request.scenario.name,
        scenario_version=request.scenario.version,
        policy=request.policy_name,
        world=request.factory.name,  # type: ignore[arg-type]
        model_hash=request.model_hash,
        dataset_hash=request.dataset_hash,
        map_source=request.street.map_source,
        seed=simulation.seed,
        rate_hz=request.scenario.rate_hz,
        steps=simulation.now.step,
        ending=drive.ending,
        sensors=None if request.sensors is None else request.sensors.name,
        reason=None if drive.error is None else str(drive.error),
        views=None if drive.renderer is None else drive.renderer.view_counts(),
        route_m=tuple((float(x), float(y)) for x, y in simulation.route.way.points),
        threads=threads,
        versions=versions,
        files=list_files(out),
    )


@lru_cache(maxsize=1)
def _list_package_versions() -> dict[str, str]:
    return {name: version(name) for name in _PACKAGES}


def describe_map(source: MapSource | None) -> str:
    """Describe the source of a rollout's road map."""
    words: dict[MapSource | None, str] = {
        None: "of a source that is not stated",
        "synthetic": "the exact one of the synthetic street",
        "file": "the file that was named",
        "dataset": "the recorded one of the dataset",
        "fitted": "fitted to the driven lines: the drivable area is a lower bound",
    }
    return f"road map: {words[source]}"


def describe_views(views: Mapping[str, int]) -> str:
    """Describe what became of the views of a drive with generated road users."""
    return (
        f"{views['generated']} generated, {views['kept']} without a road user kept the street, {views['seeds']} seeded"
        f" the drive, {views['fallback']} as reconstructed; {views['without_network']} frames ran no network"
    )


def describe_safety(safety: SafetyReport) -> list[str]:
    """Return the worst event, the least time to collision and the margin of a rollout as lines of text."""
    figures = safety.figures
    ttc, margin = figures["least_ttc"], figures["drivable_margin"]
    lines = [_worst_event(safety)]
    least = f"{ttc.value:.2f} s, to {ttc.cause}" if math.isfinite(ttc.value) else "none within 3 s"
    lines.append(f"least time to collision: {least}")
    if margin.is_valid:
        lines.append(f"margin to the edge of the drivable area: {margin.value:.2f} m")
    return lines


def _worst_event(safety: SafetyReport) -> str:
    margin = safety.figures["drivable_margin"]
    events = []
    if safety.collisions:
        first = safety.collisions[0]
        events.append(f"collision with {first.agent} ({first.kind.value}) at {first.impact_speed_mps:.1f} m/s")
    if margin.is_valid and margin.value < 0.0:
        events.append(f"left the drivable area by {-margin.value:.2f} m")
    inside = ", and the drivable area was not left" if margin.is_valid else ""
    return ", and ".join(events) or f"no collision{inside}"
