"""A flat street, and drives over it whose road users a small generator draws."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hybridworldsim.generation.commands.model_paths import find_model_files
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.rollout import SceneGenerator
from hybridworldsim.simulator.renderers.generated import DriveGenerator, GeneratedRenderer
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.simulation import Simulation, start_simulation
from mirror.arrays import UInt8
from mirror.methods.capabilities import Capabilities
from mirror.methods.model import ModelRenderer
from mirror.protocols.views.view import RenderView
from tests.simulator.streets import scenario, straight_street

CAMERAS = ("front_wide", "rear")

WIDTH, HEIGHT, T = 24, 16, 5


@dataclass
class Drawn:
    """An image with depth."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth_m: np.ndarray


class FlatStreet:
    """A model of an empty plane: its colours depend on the place, so that images differ from step to step."""

    def __call__(self, view: RenderView) -> UInt8:
        return np.round(255.0 * self.render(view).rgb).astype(np.uint8)

    def render(self, view: RenderView) -> Drawn:
        shape = (view.height_px, view.width_px)
        shade = np.linspace(0.2, 0.7, view.width_px) + 0.01 * (view.pose.translation[0, 0] % 10.0)
        rgb = np.broadcast_to(shade[None, :, None], (*shape, 3)).astype(np.float32)
        return Drawn(rgb, np.ones(shape, np.float32), np.full(shape, 200.0, np.float32))


def start() -> Simulation:
    """A drive behind a car, at the rate of the generator's clips."""
    lead = {
        "id": "lead",
        "behaviour": {
            "kind": "hard-brake", "ahead_m": 15.0, "speed_mps": 9.0, "deceleration_mps2": 2.0, "trigger": {"ttc_s": 2.5}
        },
    }  # fmt: skip
    return start_simulation(straight_street(), scenario(lead, rate_hz=5.0))


def renderer_of(simulation: Simulation, opened: SceneGenerator, models: Path, **options: object) -> GeneratedRenderer:
    cameras = rig_cameras(simulation.street, CAMERAS, WIDTH, HEIGHT)
    model = ModelRenderer("flat", FlatStreet(), Capabilities(renders_depth=True))
    street = OpenModel(Path(), simulation.street.scene_id, ("drive-1",), model)
    base = ReconstructedRenderer(street, simulation.street, simulation.scenario, simulation.now, cameras)
    rollout = ClipRolloutOptions(SamplerSettings(2), blend_px=None)
    choice = DriveGenerator(GeneratorFiles(*find_model_files(models, None)), rollout)
    return GeneratedRenderer(
        opened, replace(choice, **options), base, simulation.street, simulation.now, cameras,
        simulation.scenario.rate_hz, simulation.seed,
    )  # fmt: skip
