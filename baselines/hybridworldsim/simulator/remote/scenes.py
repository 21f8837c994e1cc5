"""Scenes that are served: a recorded traversal of a street, its agents, and a renderer of views from anywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final

import cv2
import numpy as np

from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent, AgentStates
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.remote.walking import RecordedLine
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.renderers.rolling import fit_readout, make_shutter, poses_at
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Float32, Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera, undistorted
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.protocols.views.view import ViewShutter
from mirror.schema.scenario import Scenario

_FARTHEST_M: Final = 1e4
_FINEST: Final = 2.0


@dataclass(frozen=True, eq=False)
class ServedScene:
    """A scene that is served.

    Attributes:
        scene_id: its id: that of the recorded traversal.
        street: the street.
        tracks: the recorded road users, which requests place by their ids; in the order of their ids.
        renderer: draws the views.
        start_ns: Unix time of the beginning of the recording.
    """

    scene_id: str
    street: Street
    tracks: tuple[RecordedTrack, ...]
    renderer: Renderer
    start_ns: int = 0

    @cached_property
    def agents(self) -> tuple[Agent, ...]:
        """The recorded road users."""
        return tuple(track.agent for track in self.tracks)

    @cached_property
    def _lines(self) -> tuple[RecordedLine, ...]:
        return tuple(RecordedLine(track) for track in self.tracks)

    def render(self, views: Sequence[CameraView], places: Mapping[str, Float64], stamp_ns: int) -> Mapping[str, UInt8]:
        """Render views of any lens, at one instant.

        Args:
            views: the views.
            places: x, y, yaw and speed (4,) of the middle of agents, by their ids; all other agents are absent. Where
                the speed is NaN, it is the recorded one at the nearest point of the recorded line.
            stamp_ns: Unix time.

        Raises:
            UsageError: an id is unknown, or a lens sees nothing.
        """
        rows = {agent.agent_id: row for row, agent in enumerate(self.agents)}
        states = AgentStates.absent(len(self.agents))
        for agent_id, place in places.items():
            if agent_id not in rows:
                raise UsageError(
                    f"no road user {agent_id!r}", place=f"scene {self.scene_id}",
                    expected=f"one of its {len(rows)} recorded road users, such as {', '.join(sorted(rows)[:3])}",
                )  # fmt: skip
            row, (x, y, yaw, speed) = rows[agent_id], place.tolist()
            along, recorded = self._lines[row].at(place[:3])
            speed = recorded if math.isnan(speed) else speed
            states.x_m[row], states.y_m[row], states.yaw_rad[row], states.present[row] = x, y, yaw, True
            states.vx_mps[row], states.vy_mps[row] = speed * math.cos(yaw), speed * math.sin(yaw)
            states.along_m[row] = along
        x, y = views[0].world_SE3_camera.translation[0, :2].tolist()
        ego = EgoState(x, y, 0.0, 0.0)
        time_s = 1e-9 * (stamp_ns - self.start_ns)
        snapshot = Snapshot(0, time_s, stamp_ns, self.street.vehicle, ego, self.agents, states, {})
        planes = [replace(view, camera=_plane(view.camera), shutter=_plane_shutter(view)) for view in views]
        images = self.renderer.render_views(snapshot, planes)
        return {view.name: _through_lens(images[view.name], view.camera) for view in views}


def open_scenes(street: Street, factory: RendererFactory) -> dict[str, ServedScene]:
    """Open recorded traversals of a street as scenes: all, or for a trained model those of its training.

    Raises:
        UsageError: the street is so far from the origin of its frame that single precision is too coarse.
    """
    if np.hypot(*street.middle_m) > _FARTHEST_M:
        raise UsageError(
            f"the street is {np.hypot(*street.middle_m):.0f} m from the origin of its frame",
            expected=f"at most {_FARTHEST_M:g} m: poses on the wire are in single precision",
        )
    scenario = Scenario(name="serve")
    if street.drive is not None:
        condition = street.drive.condition
        scenario = scenario.model_copy(update={"light": condition.light, "weather": condition.weather})
    scenes = {}
    for scene_id, recording in factory.recordings_of(street).items():
        tracks = tuple(sorted(recording.tracks, key=lambda track: track.agent.agent_id))
        agents = tuple(track.agent for track in tracks)
        states = AgentStates.absent(len(agents))
        ego = EgoState(*street.middle_m, 0.0, 0.0)
        start = Snapshot(0, 0.0, recording.start_ns, street.vehicle, ego, agents, states, {})
        renderer = factory.make_at(street, scenario, start, {}, scene_id)
        scenes[scene_id] = ServedScene(scene_id, street, tracks, renderer, recording.start_ns)
    return scenes


@lru_cache(maxsize=64)
def _plane(camera: Camera) -> Camera:
    """The pinhole that is rendered for a lens, about as fine in the middle as the lens is."""
    if camera.model == "pinhole":
        return camera
    plane = undistorted(camera)
    middle = camera.unproject([(camera.cx_px - 0.5, camera.cy_px), (camera.cx_px + 0.5, camera.cy_px)]).direction
    fine = 1.0 / float(np.linalg.norm(middle[1] - middle[0])) / plane.fx_px
    return plane.scaled(min(max(fine, 1.0), _FINEST))


def _plane_shutter(view: CameraView) -> ViewShutter | None:
    """The shutter of the pinhole that is rendered for a lens: its lines are nearly those of the lens."""
    camera, shutter = view.camera, view.shutter
    if shutter is None or camera.model == "pinhole":
        return shutter
    lines = RollingShutter(
        shutter.direction, round(shutter.last_ns - shutter.first_ns), camera.width_px, camera.height_px
    )
    readout = fit_readout(camera, lines, _plane(camera))
    if readout is None:
        return shutter
    middle_ns = 0.5 * (shutter.first_ns + shutter.last_ns)
    shifted = replace(readout, first_ns=readout.first_ns + middle_ns, last_ns=readout.last_ns + middle_ns)
    ends = poses_at(shutter, 1e-9 * np.array([shifted.first_ns, shifted.last_ns]))
    return make_shutter(shifted, ends)


@lru_cache(maxsize=64)
def _maps(camera: Camera) -> tuple[Float32, Float32]:
    return _plane(camera).undistort_maps(camera)


def _through_lens(image: UInt8, camera: Camera) -> UInt8:
    """The image of a lens; what lies farther than 70 degrees from its axis is black."""
    if camera.model == "pinhole":
        return image
    across, down = _maps(camera)
    return np.asarray(cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8)
