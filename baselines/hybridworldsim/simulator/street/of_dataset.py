"""The street of a scene of a dataset: its rig, its recorded traversals, and its recorded map or one that is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import VehicleParameters
from hybridworldsim.simulator.street.ground import ground_of_points
from hybridworldsim.simulator.street.street import EgoCamera, Street, StreetRecording
from mirror.annotation.box_layer import with_box_layer
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.fitted_map import fit_road_map
from mirror.dataset.frames import Frame
from mirror.errors import DatasetError, UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.schema.documents import Roi
from mirror.schema.road_map import RoadMap, read_road_map, require_map_of
from mirror.schema.rollout import MapSource

_EDGE_M = 5.0


def street_of_dataset(
    dataset: Dataset,
    *,
    scene: str | None = None,
    traversals: Sequence[str] = (),
    road_map: Path | None = None,
    boxes: str | None = None,
) -> Street:
    """Open a scene of a dataset as a street.

    Args:
        dataset: the dataset.
        scene: the scene; None: the dataset has only one.
        traversals: traversals to read; empty: all of the scene.
        road_map: file of the scene's map; None: the recorded map of the dataset, or, if there is none, one that is
            fitted to the driven lines.
        boxes: layer of boxes ``source@version``; None: the scene has one at most.

    Raises:
        UsageError: the scene or the layer is unknown or has to be named, or the map is of another scene.
        DatasetError: the scene has no images, or its recorded map was changed.
        SchemaError: the map is broken.
    """
    scenes = dataset.scenes()
    if scene is None and len(scenes) != 1:
        raise UsageError(
            f"the dataset has {len(scenes)} scenes", place="--scene", expected=f"one of {', '.join(scenes)}"
        )
    chosen = dataset.where(scene=scene or scenes[0])
    if traversals:
        chosen = chosen.where(traversal=traversals)
    chosen = with_box_layer(chosen, boxes)
    by_traversal: dict[str, list[Frame]] = {}
    for frame in chosen.frames():
        by_traversal.setdefault(frame.traversal_id, []).append(frame)
    if not by_traversal:
        raise DatasetError("the scene has no images", place=scene or scenes[0])
    lights = {
        row["traversal_id"]: row for row in chosen.table("traversals", ["traversal_id", "light", "weather"]).to_pylist()
    }
    recordings = {
        name: _recording(name, frames, str(lights[name]["light"]), str(lights[name]["weather"]))
        for name, frames in sorted(by_traversal.items())
    }
    tracks = [frames[0].track[1] for frames in by_traversal.values()]
    chosen_map, source = _map_of(chosen, road_map, [track.translation for track in tracks])
    driven = np.concatenate([track.translation for track in tracks])
    places = np.concatenate([_centers(frames) for frames in by_traversal.values()])
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    first = next(iter(by_traversal.values()))[0]
    rig = {
        name: EgoCamera(image.camera_model, image.calibration.ego_SE3_camera, image.shutter)
        for name, image in first.images.items()
    }
    return Street(
        scene_id=scene or scenes[0],
        road_map=chosen_map,
        map_source=source,
        ground=ground_of_points(driven),
        vehicle=VehicleParameters(),
        rig=rig,
        recordings=recordings,
        middle_m=(float(middle[0]), float(middle[1])),
        radius_m=float(np.hypot(*(places - middle).T).max()) + _EDGE_M,
        roi=_roi(chosen),
    )


def _roi(dataset: Dataset) -> Roi:
    names = [*Roi.model_fields]
    row = dataset.table("scenes", names).to_pylist()[0]
    return Roi.model_validate({name: row[name] for name in names})


def _map_of(dataset: Dataset, path: Path | None, lines: list[Float64]) -> tuple[RoadMap, MapSource]:
    """The map of a view of one scene, and where it is from."""
    roi = _roi(dataset)
    if path is not None:
        road_map = read_road_map(path)
        require_map_of(road_map, roi, path)
        return road_map, "file"
    recorded = dataset.road_map(roi.scene_id)
    if recorded is not None:
        return recorded, "dataset"
    return fit_road_map(roi.scene_id, roi.frame, lines), "fitted"


def _centers(frames: list[Frame]) -> Float64:
    return np.array([frame.world_SE3_ego.translation[0, :2] for frame in frames])


def _recording(traversal_id: str, frames: list[Frame], light: str, weather: str) -> StreetRecording:
    stamps, poses = frames[0].track
    start = frames[0].timestamp_ns
    inside = (stamps >= start) & (stamps <= frames[-1].timestamp_ns)
    states = np.column_stack([poses.translation[inside, :2], _yaws(poses)[inside]])
    return StreetRecording(
        traversal_id,
        start,
        1e-9 * (stamps[inside] - start).astype(np.float64),
        states,
        tuple(_tracks(frames, start)),
        light,
        weather,
    )


def _tracks(frames: list[Frame], start_ns: int) -> list[RecordedTrack]:
    rows: dict[str, list[tuple[float, float, float, float]]] = {}
    agents: dict[str, Agent] = {}
    for frame in frames:
        boxes = frame.boxes("world")
        yaws = _yaws(boxes.pose) if len(boxes) else np.zeros(0)
        for number, track in enumerate(boxes.track_id):
            x, y = boxes.pose.translation[number, :2].tolist()
            rows.setdefault(track, []).append(((boxes.timestamp_ns - start_ns) * 1e-9, x, y, float(yaws[number])))
            length, width, height = boxes.size_m[number].tolist()
            agents[track] = Agent(track, boxes.category[number], (length, width, height))
    tracks = []
    for track, states in rows.items():
        numbers = np.array(sorted(set(states)))
        kept = np.concatenate([[True], np.diff(numbers[:, 0]) > 0.0])
        tracks.append(RecordedTrack(agents[track], numbers[kept, 0], numbers[kept, 1:]))
    return tracks


def _yaws(poses: Poses) -> Float64:
    forward = matrix_from_quaternion(poses.rotation)[:, :, 0]
    return np.arctan2(forward[:, 1], forward[:, 0])
