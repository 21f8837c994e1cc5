"""Agents as images with transparency and depth: meshes of the synthetic street in the light of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.renderers.protocol import LiveUsers, ego_pose, lens_of
from hybridworldsim.simulator.renderers.rolling import line_times, poses_at, reads_columns
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.protocols.views.view import ViewShutter
from mirror.schema.documents import Roi
from mirror.synth import (
    MARK,
    SKY,
    CameraResponse,
    Condition,
    Effects,
    Instant,
    Lens,
    Model,
    RasterizedView,
    Scene,
    Surroundings,
    cut_line,
    develop,
    rasterize_view,
)

_EFFECTS: Final = replace(Effects(), exposure=False, noise=False, vignetting=False, bloom=False, motion_blur=False)
_RESPONSE: Final = CameraResponse()
_NO_EGO: Final = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))
"""The place of the model of the ego vehicle, which is empty."""


@dataclass(frozen=True, eq=False)
class AgentImage:
    """The image of the agents alone in one camera.

    Attributes:
        rgb: (H, W, 3) colours where an agent is.
        alpha: (H, W) share of a pixel that agents cover.
        depth_m: (H, W) camera z of the agents; infinite where there is none, and only there.
        number: (H, W) number of the agent; -1 where there is none.
    """

    rgb: UInt8
    alpha: Float32
    depth_m: Float32
    number: Int32

    def cut(self, place: tuple[slice, slice]) -> AgentImage:
        """Return a part of the image, with its own memory."""
        return AgentImage(
            np.ascontiguousarray(self.rgb[place]),
            np.ascontiguousarray(self.alpha[place]),
            np.ascontiguousarray(self.depth_m[place]),
            np.ascontiguousarray(self.number[place]),
        )


class AgentLayer:
    """A drawer of the agents of a rollout, in one scene whose road users read the live states.

    Args:
        street: the street.
        condition: light and weather.
        agents: the agents.
    """

    def __init__(self, street: Street, condition: Condition, agents: Sequence[Agent]) -> None:
        self._street = street
        self._live = LiveUsers(agents, street.ground)
        lit = replace(condition, effects=_EFFECTS)
        self._scene = Scene(_EmptyPlace(street), lit, self._live.users, Model.empty())

    def at(self, snapshot: Snapshot) -> Instant:
        """Return the agents at an instant, for all cameras; in the dark the ego's headlights light the agents."""
        self._live.update(snapshot)
        return self._scene.at(snapshot.time_s, ego_pose(self._street, snapshot))

    def draw(self, instant: Instant, camera: Camera, world_SE3_camera: Poses) -> AgentImage | None:
        """Draw the agents that a pinhole camera sees; None if it sees none."""
        rotation = matrix_from_quaternion(world_SE3_camera.rotation)[0]
        return self._draw(instant.surroundings, lens_of(camera), rotation, world_SE3_camera.translation[0])

    def draw_lines(self, instant: Instant, camera: Camera, shutter: ViewShutter, time_s: float) -> AgentImage | None:
        """Draw the agents that a pinhole camera with a rolling shutter sees, each line at its own time.

        Args:
            instant: the agents at mid-exposure.
            camera: the camera.
            shutter: its shutter, with its poses.
            time_s: time of mid-exposure.
        """
        if not instant.placements:
            return None
        offsets_s, columns, lens = line_times(shutter, camera), reads_columns(shutter), lens_of(camera)
        poses = poses_at(shutter, offsets_s)
        rotations = matrix_from_quaternion(poses.rotation)
        shape = camera.height_px, camera.width_px
        image = AgentImage(
            np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32),
            np.full(shape, -1, np.int32),
        )  # fmt: skip
        for number, offset_s in enumerate(offsets_s.tolist()):
            there = self._scene.surroundings_at(instant, time_s + offset_s, _NO_EGO)
            window, at = cut_line(lens, number, column=columns)
            drawn = self._draw(there, window, rotations[number], poses.translation[number])
            if drawn is None:
                continue
            to, place = ((slice(None), number), (slice(None), at)) if columns else ((number,), (at,))
            image.rgb[to], image.alpha[to] = drawn.rgb[place], drawn.alpha[place]
            image.depth_m[to], image.number[to] = drawn.depth_m[place], drawn.number[place]
        return image if image.alpha.any() else None

    def _draw(self, surroundings: Surroundings, lens: Lens, rotation: Float64, origin: Float64) -> AgentImage | None:
        view = rasterize_view(surroundings, lens, rotation, origin)
        # What lies behind an agent is not part of it: fragments of the sky are left out of its colour.
        solid = view.which[:, 1] != SKY
        alpha = (view.surface != SKY).astype(np.float32)
        mixed = view.mixed.astype(np.bool_)
        alpha[mixed] = 0.0
        which, share = view.which[solid], view.share[solid]
        alpha += np.bincount(which[:, 0], share[:, 0], alpha.size).astype(np.float32).reshape(alpha.shape)
        if not alpha.any():
            return None
        masked = replace(view, which=which, share=share, mask=alpha)
        radiance = masked.radiance()[..., :3] / np.maximum(alpha, 1e-3)[..., None]
        bgr = develop(np.ascontiguousarray(radiance), self._scene.light.record, _RESPONSE, _EFFECTS, 0)
        depth = (view.distance_m * lens.rays[..., 2]).astype(np.float32)
        number = view.object
        edge = mixed & (view.surface == SKY)
        if edge.any():
            # The ray through the centre misses the agent: its depth and number are those of the nearest neighbour.
            near = cv2.erode(depth, np.ones((3, 3), np.uint8))
            depth = np.where(edge, near, depth)
            around = cv2.dilate(number.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
            number = np.where(edge, around, number)
            _place_thin_parts(view, rotation, depth, number)
        return AgentImage(np.ascontiguousarray(bgr[..., ::-1]), alpha, depth, number)


def _place_thin_parts(view: RasterizedView, rotation: Float64, depth: Float32, number: Int32) -> None:
    """Give the pixels of parts that no ray through a centre hits, such as spokes, the place of their surface."""
    pixel, surface = view.which.T
    rows = np.flatnonzero((surface != SKY) & ~np.isfinite(depth.reshape(-1)[pixel]))
    # Of several surfaces in a pixel, the one that covers most of it is written last.
    rows = rows[np.argsort(view.share[rows, 0], kind="stable")]
    scene, chosen = view.scene, surface[rows]
    centres = scene.spheres[chosen, :3] - view.origin
    depth.reshape(-1)[pixel[rows]] = centres @ rotation[:, 2]
    number.reshape(-1)[pixel[rows]] = np.concatenate([scene.faces["object"], scene.rounds["object"]])[chosen]


class _EmptyPlace:
    """A place without anything: only the light of its position."""

    def __init__(self, street: Street) -> None:
        self._street = street
        known = street.roi
        radius = max(street.radius_m, 1.0)
        self._roi = (
            Roi(scene_id=street.scene_id, longitude_deg=0.0, latitude_deg=45.0, radius_m=radius)
            if known is None or known.longitude_deg is None
            else known
        )

    @property
    def roi(self) -> Roi:
        return self._roi

    @property
    def model(self) -> Model:
        return Model.empty()

    @property
    def layouts(self) -> Records:
        return np.zeros((1, 1), MARK)

    @property
    def lamps(self) -> Float64:
        return np.zeros((0, 3))

    def height_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        # Only shadows on the ground read it, and there is no ground.
        return np.zeros(np.shape(x_m))

    def find_lit_lamps(self, time_s: float) -> Int64:
        return np.zeros(0, np.int64)
