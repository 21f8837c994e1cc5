"""Masks of agents that are composed into a reconstructed street, against those of the exact world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.states import Agent, AgentStates
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.renderers.exact import condition_of
from hybridworldsim.simulator.renderers.protocol import LiveUsers, ego_pose, lens_of, rig_cameras
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.street.obstacles import Walls, corners_of
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Float64, Int32
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.schema.scenario import Scenario
from mirror.synth.model import Model
from mirror.synth.render.scene import Scene
from mirror.synth.render.view import rasterize_view
from mirror.synth.truth.casting import cast_rays

SMALLEST_PX = 200
_KINDS = ("car", "car", "van", "pedestrian", "cyclist", "truck")
_AGENTS = 40
_REACH_M = 45.0
_HIDDEN_REACH_M = 25.0
_TRIES = 1500
_LONGEST_M = 10.0
_EYE_M = 1.5


@dataclass(frozen=True)
class Mask:
    """One agent in one image.

    Attributes:
        iou: intersection over union of the composed and the exact mask.
        hidden: share of the agent that the exact world hides.
        pixels: pixels of the exact mask.
        camera: name of the camera.
    """

    iou: float
    hidden: float
    pixels: int
    camera: str


def measure_masks(
    street: Street, model: OpenModel, places: int, width_px: int, *, hidden: bool = False, seed: int
) -> Iterator[Mask]:
    """Compare masks at places of a recorded drive, with agents that stand at random on the ground around them.

    The places lie in the part of the street that was recorded: a drive begins and ends outside it.

    Args:
        street: the street.
        model: its model.
        places: number of places.
        width_px: width of the images.
        hidden: only agents of which fixed objects hide a part from the ego stand there.
        seed: of their places.
    """
    cameras = rig_cameras(street, tuple(street.rig), width_px)
    scenario = Scenario(name="masks")
    recording = street.recordings[min(street.recordings)]
    poses = recording.poses[street.is_inside(recording.poses[:, :2])]
    for number, place in enumerate(np.linspace(0.1, 0.9, places)):
        # Each place has random numbers of its own.
        rng = np.random.default_rng([seed, int(hidden), number])
        x, y, yaw = poses[int(place * (len(poses) - 1))].tolist()
        snapshot = _snapshot(street, EgoState(x, y, yaw, 0.0), rng, recording.start_ns, hidden=hidden)
        if not snapshot.agents:
            continue
        world = _ExactWorld(street, scenario, snapshot)
        composed = ReconstructedRenderer(model, street, scenario, snapshot, cameras)
        composed.render(snapshot, tuple(cameras))
        instant = composed.layer.at(snapshot)
        for name in cameras:
            pose = ego_pose(street, snapshot) @ cameras[name].ego_SE3_camera
            alone = composed.layer.draw(instant, cameras[name].camera, pose)
            true, ours = world.mask(cameras[name].camera, pose), composed.agent_masks()[name]
            for agent in range(len(snapshot.agents)):
                seen = true == agent
                if alone is None or seen.sum() < SMALLEST_PX:
                    continue
                whole = (alone.number == agent) & (alone.alpha >= 0.5)
                own = ours == agent
                share = 1.0 - seen.sum() / max(whole.sum(), seen.sum())
                yield Mask(float((seen & own).sum() / (seen | own).sum()), float(share), int(seen.sum()), name)


class _ExactWorld:
    """The exact street with its agents. Only its surfaces are drawn, not their colours.

    The vehicle's own body is left out: it is part of the recorded images, but not of a reconstruction.
    """

    def __init__(self, street: Street, scenario: Scenario, snapshot: Snapshot) -> None:
        if street.drive is None:
            raise UsageError("the exact world of the street is not known")
        live = LiveUsers(snapshot.agents, street.ground)
        live.update(snapshot)
        scene = Scene(street.drive.world, condition_of(street, scenario), live.users, Model.empty())
        self._instant = scene.at(snapshot.time_s, ego_pose(street, snapshot))

    def mask(self, camera: Camera, world_SE3_camera: Poses) -> Int32:
        """Return the number (H, W) of the agent that each pixel shows; -1: none."""
        rotation = matrix_from_quaternion(world_SE3_camera.rotation)[0]
        view = rasterize_view(self._instant.surroundings, lens_of(camera), rotation, world_SE3_camera.translation[0])
        return view.object


def _fixed_near(street: Street, ego: EgoState) -> Model:
    """The fixed objects that may hide an agent of the second sample: those whose bounds reach near the ego."""
    if street.drive is None:
        raise UsageError("the exact world of the street is not known")
    model = street.drive.world.model
    faces, reach_m = model.faces, np.hypot(_HIDDEN_REACH_M, _HIDDEN_REACH_M) + _LONGEST_M
    begin = np.concatenate([[0], np.cumsum(faces["count"])[:-1]])
    rows = np.repeat(faces["first"] - begin, faces["count"]) + np.arange(faces["count"].sum())
    corners, here = model.corners[rows, :2], np.array([ego.x_m, ego.y_m])
    low, high = np.minimum.reduceat(corners, begin), np.maximum.reduceat(corners, begin)
    away = np.linalg.norm(np.maximum(np.maximum(low - here, here - high), 0.0), axis=1)
    return replace(model, faces=faces[away <= reach_m])


def _hidden_share(street: Street, fixed: Model, ego: EgoState, box: Float64, height_m: float) -> float:
    """Share of points of a box (x, y, yaw, half length, half width) that fixed objects hide from above the ego."""
    floor = corners_of(box) * 0.8 + box[:2] * 0.2
    flat = np.concatenate([floor, 0.5 * (floor + np.roll(floor, 1, axis=0))])
    x, y = np.array([ego.x_m, *flat[:, 0]]), np.array([ego.y_m, *flat[:, 1]])
    ground = np.asarray(street.ground.height_m(x, y))
    eye = np.array([ego.x_m, ego.y_m, ground[0] + _EYE_M])
    points = np.concatenate([np.column_stack([flat, ground[1:] + share * height_m]) for share in (0.2, 0.5, 0.8)])
    rays = points - eye
    length = np.linalg.norm(rays, axis=1)
    distance, index = cast_rays(fixed, eye, rays / length[:, None])
    return float(np.mean((index >= 0) & (distance < length - 0.3)))


def _snapshot(
    street: Street, ego: EgoState, rng: np.random.Generator, start_ns: int, *, hidden: bool = False
) -> Snapshot:
    fixed = _fixed_near(street, ego) if hidden else Model.empty()
    agents: list[Agent] = []
    rows: list[tuple[float, float, float, float]] = []
    for _ in range(_TRIES):
        if len(agents) == _AGENTS:
            break
        kind = _KINDS[len(agents) % len(_KINDS)]
        reach_m = _HIDDEN_REACH_M if hidden else _REACH_M
        x, y = np.array([ego.x_m, ego.y_m]) + rng.uniform(-reach_m, reach_m, 2)
        yaw = rng.uniform(-np.pi, np.pi)
        body = draw_body(kind, f"agent-{len(agents)}", 0)
        reach = 0.5 * float(np.hypot(*body.size_m[:2]))
        apart = all(np.hypot(x - a, y - b) > reach + c for a, b, _, c in rows)
        if np.hypot(x - ego.x_m, y - ego.y_m) < reach + 5.0 or not apart:
            continue
        ring = np.array([(x, y), *((x + reach * np.cos(t), y + reach * np.sin(t)) for t in np.linspace(0, 6.3, 9))])
        box = np.array([x, y, yaw, 0.5 * body.size_m[0], 0.5 * body.size_m[1]])
        if hidden and not 0.3 <= _hidden_share(street, fixed, ego, box, body.size_m[2]) <= 0.9:
            continue
        if not street.is_inside(ring).all() or Walls.of(street).find(ring):
            continue
        agents.append(Agent(f"agent-{len(agents):02d}", kind, body.size_m, body))
        rows.append((x, y, yaw, reach))
    columns = np.array(rows).reshape(-1, 4)
    zeros = np.zeros(len(agents))
    states = AgentStates(
        columns[:, 0], columns[:, 1], columns[:, 2], zeros, zeros.copy(), zeros.copy(), np.ones(len(agents), np.bool_)
    )
    return Snapshot(0, 0.0, start_ns, street.vehicle, ego, tuple(agents), states, {})
