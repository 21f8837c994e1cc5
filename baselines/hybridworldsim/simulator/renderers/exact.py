"""The exact world: the synthetic street with the agents in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import CameraView, LiveUsers, Renderer, ego_pose, lens_of
from hybridworldsim.simulator.renderers.rolling import line_times, poses_at, reads_columns
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Int32, UInt8
from mirror.errors import UsageError
from mirror.schema.scenario import Scenario
from mirror.synth import Condition, instant_of

if TYPE_CHECKING:
    from mirror.synth import Instant, RenderedImage, RollingImage, Scene, SynthDrive

_NOISE_SEEDS = 1 << 31
_SCENES_HELD: Final = 2


class ExactRenderer(Renderer):
    """A renderer of the synthetic street, with one scene for a rollout, whose road users read the live states.

    Args:
        street: a synthetic street.
        scenario: its light and weather.
        start: the state at the start.
        cameras: the cameras, by name.
        seed: seed of the images' noise.
        shows_ego: whether the body of the ego vehicle is drawn, as the cameras of its rig see it.

    Raises:
        UsageError: the exact world of the street is not known.
    """

    name = "exact"

    def __init__(
        self,
        street: Street,
        scenario: Scenario,
        start: Snapshot,
        cameras: Mapping[str, CameraSpec],
        seed: int,
        *,
        shows_ego: bool = True,
    ) -> None:
        from mirror.synth import Model, SurfaceBuffer

        if street.drive is None:
            raise UsageError(
                "the exact world of this street is not known", place="renderer",
                expected="a synthetic street: synth:PRESET[:SEED[:DRIVE]]",
                remedy="use the renderer boxes or reconstructed",
            )  # fmt: skip
        super().__init__(street, cameras)
        self._seed = seed
        self._live = LiveUsers(start.agents, street.ground)
        condition = condition_of(street, scenario)
        drive = street.drive
        ego = drive.ego_model if shows_ego else Model.empty()
        self._scene = _empty_scene(drive, condition).with_road_users(self._live.users, ego, clock_s=street.clock_s)
        self._surfaces = SurfaceBuffer()
        self._masks: dict[str, Int32] = {}

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        self._live.update(snapshot)
        instant = self._scene.at(snapshot.time_s, ego_pose(self._street, snapshot), buffer=self._surfaces)
        images: dict[str, UInt8] = {}
        for number, view in enumerate(views):
            noise = np.random.SeedSequence([self._seed, number, snapshot.step]).generate_state(1, np.uint64)[0]
            rendered = self._draw_view(snapshot, instant, view, int(noise % _NOISE_SEEDS))
            images[view.name] = np.ascontiguousarray(rendered.bgr[..., ::-1])
            self._masks[view.name] = rendered.view.object
        return images

    def _draw_view(
        self, snapshot: Snapshot, instant: Instant, view: CameraView, seed: int
    ) -> RenderedImage | RollingImage:
        lens = lens_of(view.camera)
        if view.shutter is None:
            return self._scene.render(instant, lens, view.world_SE3_camera, seed=seed)
        offsets_s = line_times(view.shutter, view.camera)
        cameras = poses_at(view.shutter, offsets_s)
        # the vehicle moves with its camera
        egos = cameras @ (view.world_SE3_camera.inverse() @ ego_pose(self._street, snapshot))
        return self._scene.render_lines(
            instant, lens, snapshot.time_s + offsets_s, egos, cameras, columns=reads_columns(view.shutter), seed=seed
        )

    def agent_masks(self) -> Mapping[str, Int32]:
        """Return, for the last images, the number (H, W) of the agent that each pixel shows; -1: none."""
        return self._masks


@lru_cache(maxsize=_SCENES_HELD)
def _empty_scene(drive: SynthDrive, condition: Condition) -> Scene:
    """Make the scene without road users, whose fixed surfaces and shadows its drives share."""
    from mirror.synth import Model, Scene

    scene = Scene(drive.world, condition, (), Model.empty())
    scene.prepare()
    return scene


def condition_of(street: Street, scenario: Scenario) -> Condition:
    """Return the light and weather of a scenario for a synthetic street, on the day of the street's drive."""
    drive = street.drive
    if drive is None:
        raise UsageError("the street is not synthetic")
    condition, roi = drive.condition, drive.roi
    if (scenario.light, scenario.weather) == (condition.light, condition.weather):
        return condition
    start = instant_of(
        drive.recipe.date, scenario.light, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0,
        morning=drive.recipe.morning,
    )  # fmt: skip
    return replace(condition, start_ns=start, light=scenario.light, weather=scenario.weather)
