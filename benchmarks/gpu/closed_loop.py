"""A closed-loop step with seven cameras, in the block that the training of this benchmark made."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.streets import StreetData
from benchmarks.simulator.benchmark import drive_steps, replay_scenario, with_traffic
from benchmarks.simulator.block import open_block
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.simulation import start_simulation

_STEPS = 20


def measure_loop(machine: Machine, street: StreetData, model_folder: Path) -> dict[str, float]:
    """Time steps of a drive with twenty road users: the images of seven cameras, their composition, and the world.

    Raises:
        DatasetError: the block is not trained to the end.
    """
    opened = with_traffic(open_block(street.dataset, street.preset))
    model = OpenModel.read(model_folder, opened, device=machine.device)
    scenario = replay_scenario()
    width, height = machine.size_px()
    cameras = rig_cameras(opened, tuple(opened.rig), width, height)
    simulation = start_simulation(opened, scenario, stops_at_collision=False)
    renderer = ReconstructedRenderer(model, opened, scenario, simulation.now, cameras)
    # The first images compile and allocate.
    renderer.render(simulation.now, tuple(cameras))
    times_s, _ = drive_steps(simulation, renderer, machine.count(_STEPS, 5))
    return {"a closed-loop step, seven cameras 960x540": 1e3 * float(np.median(times_s))}
