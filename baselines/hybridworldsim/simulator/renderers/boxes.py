"""Wireframes: lanes, the drivable area and the boxes of agents, for tests and for research on planning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer
from hybridworldsim.simulator.renderers.rolling import poses_at
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Float64, UInt8
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling

_NEAR_M: Final = 0.3
_FAR_M: Final = 120.0
_STEP_M: Final = 2.0
_SKY: Final = (196, 214, 235)
_GROUND: Final = (150, 150, 146)
_LANE: Final = (245, 245, 245)
_EDGE: Final = (235, 170, 60)
COLOURS: Final = {
    "car": (200, 40, 40), "van": (170, 60, 30), "truck": (120, 50, 120), "bus": (150, 30, 110),
    "motorcycle": (30, 110, 160), "bicycle": (20, 130, 90), "cyclist": (20, 130, 90), "pedestrian": (30, 60, 200),
}  # fmt: skip
"""Colours of agents by category, RGB."""
_OTHER: Final = (90, 90, 90)
_EDGES: Final = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))


class _Lines(NamedTuple):
    """Segments (S, 2, 3) of one colour that move together."""

    segments: Float64
    colour: tuple[int, int, int]
    velocity_mps: Float64 = np.zeros(3)


class BoxesRenderer(Renderer):
    """A renderer that draws agents as wireframes.

    Args:
        street: the street.
        cameras: the cameras, by name; pinholes.
    """

    name = "boxes"

    def __init__(self, street: Street, cameras: Mapping[str, CameraSpec]) -> None:
        super().__init__(street, cameras)
        lanes = [_segments(lane.center_m) for lane in street.road_map.lanes_of()]
        self._lanes = np.concatenate([np.zeros((0, 2, 3)), *lanes])
        rings = [_on_ground(street, np.vstack([ring, ring[:1]])) for ring in street.road_map.drivable_rings]
        self._edges = np.concatenate([np.zeros((0, 2, 3)), *(_segments(ring) for ring in rings)])

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        states = snapshot.states
        boxes = [
            _Lines(
                self._wireframe(snapshot, number),
                COLOURS.get(agent.category, _OTHER),
                np.array([states.vx_mps[number], states.vy_mps[number], 0.0]),
            )
            for number, agent in enumerate(snapshot.agents)
            if states.present[number]
        ]
        return {view.name: self._draw(view, boxes) for view in views}

    def _wireframe(self, snapshot: Snapshot, number: int) -> Float64:
        """Edges (12, 2, 3) of the box of an agent."""
        states, (length, width, height) = snapshot.states, snapshot.agents[number].size_m
        place = self._street.ground.place(
            float(states.x_m[number]), float(states.y_m[number]), float(states.yaw_rad[number]), length, width
        )
        flat = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]) * (0.5 * length, 0.5 * width)
        corners = np.concatenate([np.column_stack([flat, np.full(4, z)]) for z in (0.0, height)])
        world = corners @ place.rotation.T + place.translation
        return world[np.array(_EDGES)]

    def _draw(self, view: CameraView, boxes: Sequence[_Lines]) -> UInt8:
        camera, rotation = view.camera, view.world_SE3_camera.matrix()[0, :3, :3]
        rows = np.arange(camera.height_px)[:, None] + 0.5
        columns = np.arange(camera.width_px)[None, :] + 0.5
        x, y = (columns - camera.cx_px) / camera.fx_px, (rows - camera.cy_px) / camera.fy_px
        upward = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
        image: UInt8 = np.where((upward > 0.0)[..., None], np.array(_SKY, np.uint8), np.array(_GROUND, np.uint8))
        image = np.ascontiguousarray(image)
        layers = [_Lines(self._lanes, _LANE), _Lines(self._edges, _EDGE), *boxes]
        thickness = max(round(camera.width_px / 240), 1)
        for lines in layers:
            for start, end in _project(lines, view, rotation):
                cv2.line(image, start, end, lines.colour, thickness, cv2.LINE_AA)
        return image


def _segments(line: Float64) -> Float64:
    """Segments (S, 2, 3) of at most `_STEP_M` of a line, so that clipping by range is fine."""
    steps = np.hypot(*np.diff(line[:, :2], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_M), 1) + 1)
    points = np.column_stack([np.interp(even, along, line[:, axis]) for axis in range(3)])
    return np.stack([points[:-1], points[1:]], axis=1)


def _on_ground(street: Street, ring: Float64) -> Float64:
    return np.column_stack([ring, np.asarray(street.ground.height_m(ring[:, 0], ring[:, 1]))])


def _project(lines: _Lines, view: CameraView, rotation: Float64) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Pixels of the segments before the near plane, clipped at it; a rolling shutter sees each end at its own time."""
    camera, segments, origin = view.camera, lines.segments, view.world_SE3_camera.translation[0]
    near = segments[np.linalg.norm(segments.mean(axis=1) - origin, axis=1) < _FAR_M]
    points = (near - origin) @ rotation
    seen = points[(points[..., 2] > _NEAR_M).any(axis=1)]
    z = seen[..., 2]
    share = np.clip((_NEAR_M - z[:, 0]) / np.where(z[:, 1] == z[:, 0], 1.0, z[:, 1] - z[:, 0]), 0.0, 1.0)
    cut = seen[:, 0] + share[:, None] * (seen[:, 1] - seen[:, 0])
    clipped = seen.copy()
    clipped[z[:, 0] < _NEAR_M, 0] = cut[z[:, 0] < _NEAR_M]
    clipped[z[:, 1] < _NEAR_M, 1] = cut[z[:, 1] < _NEAR_M]
    if view.shutter is not None:
        clipped = _at_line_times(clipped, view, rotation, lines.velocity_mps)
    u = camera.fx_px * clipped[..., 0] / clipped[..., 2] + camera.cx_px - 0.5
    v = camera.fy_px * clipped[..., 1] / clipped[..., 2] + camera.cy_px - 0.5
    inside = (np.abs(u) < 1e4).all(axis=1) & (np.abs(v) < 1e4).all(axis=1)
    ends = np.round(np.stack([u, v], axis=2)[inside]).astype(int).tolist()
    return [((a, b), (c, d)) for (a, b), (c, d) in ends]


def _at_line_times(points: Float64, view: CameraView, rotation: Float64, velocity_mps: Float64) -> Float64:
    """Points (S, 2, 3) before the camera at mid-exposure -> where the camera is before them when its lines see them."""
    shutter, camera = view.shutter, view.camera
    if shutter is None or not points.size:
        return points
    world = points.reshape(-1, 3) @ rotation.T + view.world_SE3_camera.translation
    middle_s = 0.5e-9 * (shutter.first_ns + shutter.last_ns)
    readout_ns = round(shutter.last_ns - shutter.first_ns)

    def points_at(offsets_ns: Float64) -> Float64:
        times_s = middle_s + 1e-9 * offsets_ns
        moved = world + times_s[:, None] * velocity_mps
        return np.asarray(poses_at(shutter, times_s).inverse().transform(moved[:, None])[:, 0])

    raster = RollingShutter(shutter.direction, readout_ns, camera.width_px, camera.height_px)
    _, _, times_ns = project_rolling(camera, raster, len(world), points_at)
    seen = points_at(times_ns)
    seen[:, 2] = np.maximum(seen[:, 2], _NEAR_M)
    return seen.reshape(points.shape)
