"""Training images of the perception: exact views from places beside and turned away from the middle of a lane."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.studies.closed_loop.exact_camera import ExactCamera
from benchmarks.studies.closed_loop.percepts import perceive_exactly
from benchmarks.studies.closed_loop.streets import Place, Vehicle, open_training_place
from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.states import Agent, AgentStates
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.street.route import way_along
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import AnyArray, Float64, UInt8
from mirror.errors import DatasetError
from mirror.progress import ProgressReporter
from mirror.schema.road_features import MapLane
from mirror.traffic.lanes.ways import STEP_M, Way

_KINDS: Final = ("car", "car", "car", "van", "truck", "car", "cyclist", "pedestrian", "motorcycle", "bus")
_LEAD_KINDS: Final = ("car", "car", "car", "van", "cyclist", "pedestrian", "truck")
_NARROWEST_M: Final = 3.0
_SIDES_M: Final = ((2.9, 3.9), (5.5, 9.0), (-3.2, -2.5), (-7.0, -4.0))
"""Places beside the lane, to the left: an oncoming lane, beyond it, parked at the kerb, on the pavement."""
_CLEAR_M: Final = 1.5
_SPEEDS_MPS: Final = (0.0, 9.0)


@dataclass(frozen=True, eq=False)
class PerceptionImages:
    """Images with their exact percepts.

    Attributes:
        images: (N, H, W, 3) RGB.
        percepts: (N, 3) offset, heading and distance of the lead.
        turn_rad: (N,) heading of the vehicle against the lane beside it.
        street: (N,) number of the street.
        light: (N,) light.
    """

    images: UInt8
    percepts: Float64
    turn_rad: Float64
    street: AnyArray
    light: AnyArray

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, rows: AnyArray) -> PerceptionImages:
        return PerceptionImages(*(column[rows] for column in vars(self).values()))


def make_perception_images(
    vehicle: Vehicle,
    images: Mapping[str, Any],
    preset: str,
    lookahead_m: float,
    folder: Path,
    progress: ProgressReporter,
    *,
    validation: bool = False,
) -> PerceptionImages:
    """Make the images of all streets, or those of validation; the parts of an interrupted call are kept."""
    seeds = [images["validation_seed"]] if validation else images["seeds"]
    share = float(images["validation_share"]) if validation else 1.0
    streets = [(site, seed) for site in images["sites"] for seed in seeds]
    parts = [
        (number, seed, site, drive, max(round(share * count), 1))
        for number, (site, seed) in enumerate(streets)
        for drive, count in images["drives"].items()
    ]
    progress.start("images of perception", len(parts))
    found = []
    for number, seed, site, drive, count in parts:
        path = part_file(folder, site, drive, seed)
        if not path.is_file():
            place = open_training_place(vehicle, preset, seed, f"{site}-{drive}")
            _write(path, _draw_part(place, images, lookahead_m, count, (seed, number)))
        found.append(_read(path, number))
        progress.advance(1)
    return PerceptionImages(*(np.concatenate(columns) for columns in zip(*(vars(one).values() for one in found))))


def part_file(folder: Path, site: str, drive: str, seed: int) -> Path:
    """Return the file of the images of a street in the light of a drive."""
    return folder / f"{site}-{drive}-{seed}.npz"


def _write(path: Path, part: PerceptionImages) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    with temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **vars(part))
    temporary.replace(path)


def _read(path: Path, street: int) -> PerceptionImages:
    with np.load(path) as file:
        part = PerceptionImages(**{name: file[name] for name in file.files})
    if len(part) and part.street[0] != street:
        raise DatasetError(
            f"images of street {part.street[0]}", file=path, expected=f"street {street}", remedy="choose another --out"
        )
    return part


def _draw_part(
    place: Place, images: Mapping[str, Any], lookahead_m: float, count: int, seed: tuple[int, int]
) -> PerceptionImages:
    number = int(place.drive.drive_id.rpartition("-")[2])
    rng = np.random.default_rng([*seed, number])
    ways = list(_ways(place))
    rows: list[tuple[UInt8, tuple[float, float, float], float]] = []
    while len(rows) < count:
        pool = min(int(images["images_of_a_pool"]), count - len(rows))
        rows += _draw_pool(place, ways, images, lookahead_m, pool, (*seed, number, len(rows)), rng)
    return PerceptionImages(
        np.stack([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
        np.full(count, seed[1]),
        np.full(count, place.drive.condition.light),
    )


def _draw_pool(
    place: Place,
    ways: Sequence[tuple[Way, Float64]],
    images: Mapping[str, Any],
    lookahead_m: float,
    count: int,
    seed: tuple[int, ...],
    rng: np.random.Generator,
) -> list[tuple[UInt8, tuple[float, float, float], float]]:
    """Images with the same bodies and an own place each."""
    agents = []
    for index in range(int(images["agents"])):
        kinds = _LEAD_KINDS if index == 0 else _KINDS
        body = draw_body(kinds[int(rng.integers(len(kinds)))], f"agent-{index}", int(rng.integers(1 << 30)))
        agents.append(Agent(f"agent-{index}", body.category, body.size_m, body))
    camera = ExactCamera(place, agents, 0.0, seed)
    rows = []
    for step in range(count):
        way, inside = ways[int(rng.integers(len(ways)))]
        along = float(inside[int(rng.integers(len(inside)))])
        offset = float(rng.uniform(-1.0, 1.0)) * images["offset_m"]
        turn = math.radians(float(rng.uniform(-1.0, 1.0)) * images["yaw_deg"])
        x, y, yaw = _pose(way, along, offset, turn)
        ego = EgoState(x, y, yaw, 0.0)
        states = _draw_states(place, way, along, agents, images, rng)
        shot = Snapshot(step, 0.0, place.drive.condition.start_ns, place.street.vehicle, ego, tuple(agents), states, {})
        exact = perceive_exactly(
            way.points, ego, shot.boxes().states, place.street.vehicle, lookahead_m, images["sight_m"]
        )
        (image,) = camera.render(shot, tuple(place.cameras)).values()
        rows.append((image, (exact.offset_m, exact.heading_rad, exact.lead_m), turn))
    return rows


def _ways(place: Place) -> Iterator[tuple[Way, Float64]]:
    """Lanes of the street with what follows them, and the lengths at which they lie in its rendered part."""
    road_map = place.street.road_map
    for lane in road_map.lanes_of(("drive",)):
        if float(np.min(lane.width_m)) < _NARROWEST_M:
            continue
        way = way_along([lane, *_following(road_map.lanes, lane)])
        length = STEP_M * np.arange(len(way.points), dtype=np.float64)
        inside = length[place.street.is_inside(way.points) & (length <= lane.length_m) & (length < way.length_m - 5.0)]
        if len(inside):
            yield way, inside


def _following(lanes: Mapping[str, MapLane], lane: MapLane) -> Iterator[MapLane]:
    """The next two lanes straight on."""
    for _ in range(2):
        if not lane.successors:
            return
        end = _heading(lane, -1)
        lane = min(
            (lanes[name] for name in lane.successors),
            key=lambda one: abs(math.remainder(_heading(one, -1) - end, 2.0 * math.pi)),
        )
        yield lane


def _heading(lane: MapLane, index: int) -> float:
    step = np.diff(lane.center_m[:, :2], axis=0)[index]
    return math.atan2(step[1], step[0])


def _pose(way: Way, along_m: float, offset_m: float, turn_rad: float) -> tuple[float, float, float]:
    x, y = way.at(along_m)
    index = min(round(along_m / STEP_M), len(way.points) - 1)
    heading = float(way.heading_rad[index])
    return float(x - math.sin(heading) * offset_m), float(y + math.cos(heading) * offset_m), heading + turn_rad


def _draw_states(
    place: Place, way: Way, along_m: float, agents: Sequence[Agent], images: Mapping[str, Any], rng: np.random.Generator
) -> AgentStates:
    """Agent 0 is in the lane ahead, or absent; the others stand or drive beside it."""
    states = AgentStates.absent(len(agents))
    vehicle = place.street.vehicle
    front = along_m + vehicle.rear_axle_to_center_m + 0.5 * vehicle.length_m
    for index, agent in enumerate(agents):
        if rng.uniform() >= (images["lead_share"] if index == 0 else images["other_share"]):
            continue
        half = 0.5 * agent.size_m[0]
        if index == 0:
            gap = _CLEAR_M + (images["sight_m"] - _CLEAR_M) * float(rng.uniform()) ** 1.3
            at, aside, turn = front + gap + half, float(rng.uniform(-0.6, 0.6)), float(rng.normal(0.0, 0.06))
        else:
            side = _SIDES_M[int(rng.integers(len(_SIDES_M)))]
            at, aside = along_m + float(rng.uniform(8.0, 55.0)), float(rng.uniform(*side))
            turn = math.pi if aside > 0.0 else 0.0
        if agent.category == "pedestrian":
            turn = float(rng.uniform(-math.pi, math.pi))
        x, y, yaw = _pose(way, min(at, way.length_m), aside, turn)
        speed = float(rng.uniform(*_SPEEDS_MPS))
        states.x_m[index], states.y_m[index], states.yaw_rad[index] = x, y, yaw
        states.vx_mps[index], states.vy_mps[index] = speed * math.cos(yaw), speed * math.sin(yaw)
        states.along_m[index], states.present[index] = float(rng.uniform(0.0, 10.0)), True
    return states
