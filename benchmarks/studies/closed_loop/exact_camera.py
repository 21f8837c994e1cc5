"""The exact world as the camera of a recorded drive shows it, without the ego vehicle's own body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from benchmarks.studies.closed_loop.streets import Place
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.renderers.protocol import CameraView, LiveUsers, Renderer, ego_pose, lens_of
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import UInt8
from mirror.synth.model import Model
from mirror.synth.render.scene import Scene

_SEEDS: Final = 1 << 31


class ExactCamera(Renderer):
    """Renders the synthetic street; its road users read the live states.

    `ExactRenderer` of the simulator draws the vehicle's own body, which reconstructions do not have, and a camera
    without a response of its own, while reconstructions learn that of the recording camera. Else it is the same.

    Args:
        place: the street and the drive whose light and camera the images have.
        agents: the agents.
        clock_s: time of the signals' clock at the start.
        seed: seed of the images' noise.
    """

    name = "exact"

    def __init__(self, place: Place, agents: Sequence[Agent], clock_s: float, seed: tuple[int, ...]) -> None:
        super().__init__(place.street, place.cameras)
        self._seed = seed
        self._live = LiveUsers(agents, place.street.ground)
        drive = place.drive
        self._responses = drive.camera_responses
        self._scene = Scene(drive.world, drive.condition, self._live.users, Model.empty(), clock_s=clock_s)

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        self._live.update(snapshot)
        instant = self._scene.at(snapshot.time_s, ego_pose(self._street, snapshot))
        images: dict[str, UInt8] = {}
        for number, view in enumerate(views):
            words = [*self._seed, number, snapshot.step]
            noise = int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0] % _SEEDS)
            rendered = self._scene.render(
                instant, lens_of(view.camera), view.world_SE3_camera, response=self._responses[view.name], seed=noise
            )
            images[view.name] = np.ascontiguousarray(rendered.bgr[..., ::-1])
        return images
