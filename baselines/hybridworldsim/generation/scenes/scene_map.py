"""The map of a scene, for a generator that is shown one."""

from __future__ import annotations

from dataclasses import dataclass

from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.generation.clips.road_map import lines_of_map
from hybridworldsim.generation.layout.images import takes_map
from hybridworldsim.generation.scenes.rollout import SceneGenerator
from mirror.dataset.dataset import Dataset
from mirror.progress import ProgressReporter
from mirror.schema.files import sha256_bytes
from mirror.schema.road_map import encode_road_map


@dataclass(frozen=True, eq=False)
class SceneMap:
    """The lines of a scene's map that the generator takes as input.

    Attributes:
        lines: lines in the scene's frame; None: no map is known, or the generator takes none.
        inputs: what of it determines generated frames: the map's hash, or None; empty where the generator takes none.
    """

    lines: tuple[MapLine, ...] | None
    inputs: dict[str, str | None]


def open_scene_map(dataset: Dataset, scene: str, generator: SceneGenerator, progress: ProgressReporter) -> SceneMap:
    """Open the recorded map of a scene, if the generator takes one.

    Where there is none, that is said and nothing is drawn.

    Args:
        dataset: the dataset.
        scene: the scene.
        generator: the generator; it decides whether the map is read.
        progress: receives the message.

    Raises:
        UsageError: the map is of another scene or in another frame.
        DatasetError: the map's file is missing or was changed.
        SchemaError: the file is not a road map, or a feature is invalid.
    """
    if not takes_map(generator.network.config, generator.style):
        return SceneMap(None, {})
    road_map = dataset.road_map(scene)
    if road_map is None:
        progress.message(
            f"scene {scene} has no recorded map: the generator, which takes one, gets no lines. `mirror ingest --map`"
            " adds a map to a dataset."
        )
        return SceneMap(None, {"map": None})
    driven = dataset.where(scene=scene).frames()[0].track[1].translation
    return SceneMap(lines_of_map(road_map, driven), {"map": sha256_bytes(encode_road_map(road_map))})
