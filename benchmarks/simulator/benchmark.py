"""Closed loop: steps a second of a reconstructed street by part, errors of the vehicle, masks of composed agents.

``python -m benchmarks simulator`` trains the block of `mirror demo` first (4 core-minutes) or takes ``--block FOLDER``.
The wall time of a step needs two idle cores; the processor time beside it does not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.report import Row, median_ms, report
from benchmarks.simulator.block import open_block, trained_block
from benchmarks.simulator.masks import measure_masks
from benchmarks.simulator.wire import measure_wire
from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters, advance
from hybridworldsim.simulator.policies.references import Log
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.simulation import Simulation, start_simulation
from hybridworldsim.simulator.street.of_synth import open_synthetic_street
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.street import Street
from mirror.command_line import parse_arguments
from mirror.errors import UsageError
from mirror.schema.scenario import Scenario

_AGENTS = 20
_STEPS: Final = 40
_CAST: Final = (19, 40, 60)
_SLOWEST_CASTING_MS: Final = 250.0
_SLOWEST_STEP_MS: Final = 1000.0 / 6.0


@dataclass(frozen=True)
class Arguments:
    """Measure the closed loop: the vehicle, a step without images, a step with seven cameras, masks of agents."""

    block: Path | None = None
    """Folder with dataset/ and model/ of a block; default: benchmarks/out/simulator/block, made if it is missing."""
    street: str | None = None
    """Compare masks only, in a street synth:PRESET:SEED:DRIVE that --model was trained on."""
    model: Path | None = None
    """The model of --street."""
    places: int = 8
    """Number of places at which masks are compared; four times as many for partly hidden agents."""
    seed: int = 0
    """Seed of the agents of which masks are compared."""
    threads: int = 2
    """Number of threads."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = parse_arguments(
        Arguments, argv, "python -m benchmarks simulator",
        examples=("python -m benchmarks simulator", "python -m benchmarks simulator --block demo/block"),
    )  # fmt: skip
    import torch

    torch.set_num_threads(arguments.threads)
    if (arguments.street is None) != (arguments.model is None):
        raise UsageError("--street and --model belong together", expected="both of them or neither")
    if arguments.street is not None and arguments.model is not None:
        street = open_synthetic_street(arguments.street)
        masks = _masks(street, OpenModel.read(arguments.model, street), arguments.places, arguments.seed)
        return report("simulator-masks", {"masks": masks}, errors="error")
    dataset, model_folder = trained_block(arguments.block)
    street = open_block(dataset)
    model = OpenModel.read(model_folder, street)
    groups = {
        "vehicle": _vehicle(),
        "wire": measure_wire(street),
        "casting": _casting(),
        "steps": _steps(street, model),
        "masks": _masks(street, model, arguments.places, arguments.seed),
    }
    return report("simulator", groups, errors="error")


def _vehicle() -> Iterator[Row]:
    """Error of steps of 0.1 s against steps of 0.1 ms over 4 s, with controls that change every step."""
    car, rng = VehicleParameters(), np.random.default_rng(0)
    commands = [Controls(float(a), float(k)) for a, k in rng.uniform((-6.0, -0.2), (4.0, 0.2), (40, 2))]
    start = EgoState(0.0, 0.0, 0.0, 12.0)

    def drive(parts: int) -> EgoState:
        state = start
        for command in commands:
            for _ in range(parts):
                state = advance(car, state, command, 0.1 / parts)
        return state

    coarse, fine = drive(1), drive(1000)
    error = math.hypot(coarse.x_m - fine.x_m, coarse.y_m - fine.y_m)
    yield Row("vehicle, step of 0.1 s", "40 steps", median_ms(lambda: drive(1)) / 40.0, error, unit="m", error_bar=1e-6)


def _steps(street: Street, model: OpenModel) -> Iterator[Row]:
    street, scenario = with_traffic(street), replay_scenario()
    simulation = start_simulation(street, scenario, stops_at_collision=False)
    size = f"{len(simulation.now.agents)} agents"
    times, _ = drive_steps(simulation, None)
    yield Row("step without images", size, 1e3 * float(np.median(times)))
    cameras = rig_cameras(street, tuple(street.rig), 240, 135)
    simulation = start_simulation(street, scenario, stops_at_collision=False)
    renderer = ReconstructedRenderer(model, street, scenario, simulation.now, cameras)
    renderer.render(simulation.now, tuple(cameras))
    renderer.seconds.clear()
    times, cores = drive_steps(simulation, renderer)
    size = f"7 x 240x135, {size}"
    yield Row("step, reconstructed (wall)", size, 1e3 * float(np.median(times)), bar=_SLOWEST_STEP_MS)
    yield Row("step, reconstructed (core time)", size, 1e3 * float(np.median(cores)))
    for name, seconds in renderer.seconds.parts().items():
        yield Row(f"- {name} (thread time)", size, 1e3 * seconds / len(times))


def _casting() -> Iterator[Row]:
    """Start of a drive on a street that is open, with more agents than find room."""
    street = open_street("synth:block")
    for count in _CAST:
        asked = {"id": "car", "category": "car", "count": count, "behaviour": {"kind": "idm"}}
        scenario = Scenario.model_validate({"name": "full", "ego": {"speed_mps": 8.0}, "agents": [asked]})
        placed = len(start_simulation(street, scenario).now.agents)
        spent = median_ms(lambda: start_simulation(street, scenario))  # noqa: B023
        yield Row("casting of agents", f"{count} asked, {placed} placed", spent, bar=_SLOWEST_CASTING_MS)


def drive_steps(
    simulation: Simulation, renderer: ReconstructedRenderer | None, steps: int = _STEPS
) -> tuple[list[float], list[float]]:
    """Drive some steps; return the wall time and the processor time of each, in seconds."""
    policy = Log()
    policy.reset(simulation.observation_spec({}))
    times, cores = [], []
    for _ in range(steps):
        begin, core = time.perf_counter(), time.process_time()
        images = {} if renderer is None else renderer.render(simulation.now, tuple(simulation.street.rig))
        simulation.advance(policy.act(simulation.observe(images, privileged=True)))
        times.append(time.perf_counter() - begin)
        cores.append(time.process_time() - core)
    return times, cores


def with_traffic(street: Street) -> Street:
    """Return the street with a recording of vehicles around the recorded drive, which move with it."""
    recording = street.recordings[min(street.recordings)]
    rng, tracks = np.random.default_rng(0), []
    for number in range(_AGENTS):
        kind = ("car", "car", "van", "cyclist", "pedestrian")[number % 5]
        body = draw_body(kind, f"agent-{number}", 0)
        ahead = 0.5 * (number - 0.3 * _AGENTS)
        aside = float(rng.uniform(-9.0, 9.0)) if abs(ahead) > 1.0 else 9.0
        poses = np.column_stack(
            [np.interp(recording.times_s + ahead, recording.times_s, line) for line in recording.poses.T]
        )
        poses[:, 0] -= aside * np.sin(poses[:, 2])
        poses[:, 1] += aside * np.cos(poses[:, 2])
        tracks.append(RecordedTrack(Agent(f"{number:02d}", kind, body.size_m, body), recording.times_s, poses))
    traffic = replace(recording, tracks=tuple(tracks))
    return replace(street, recordings={**street.recordings, recording.traversal_id: traffic})


def replay_scenario() -> Scenario:
    """Return the scenario that replays the recorded vehicles."""
    replayed = {"id": "agent", "behaviour": {"kind": "replay"}}
    return Scenario.model_validate({"name": "speed", "ego": {"start": {"kind": "recorded"}}, "agents": [replayed]})


def _masks(street: Street, model: OpenModel, places: int, seed: int) -> Iterator[Row]:
    """1 - IoU, so that smaller is better. Agents of the second sample stand where fixed objects hide a part of them."""
    masks = list(measure_masks(street, model, places, 480, seed=seed))
    hidden = list(measure_masks(street, model, 4 * places, 480, hidden=True, seed=seed))
    partly = [mask for mask in (*masks, *hidden) if 0.3 <= mask.hidden <= 0.9]
    for name, chosen, share, bar in (
        ("all, median", masks, 0.5, 0.1),
        ("all, 10th percentile", masks, 0.1, 0.3),
        ("30-90 % hidden, median", partly, 0.5, 0.25),
        ("30-90 % hidden, 10th percentile", partly, 0.1, None),
    ):
        lost = 1.0 - float(np.quantile([mask.iou for mask in chosen], share)) if chosen else math.nan
        yield Row(f"masks of agents: {name}", f"{len(chosen)} masks", 0.0, lost, unit="1 - IoU", error_bar=bar)
