"""Opens a street by what a user types: the name of a synthetic street, or the folder of a dataset."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from hybridworldsim.simulator.street.of_synth import SCHEME
from hybridworldsim.simulator.street.street import Street
from mirror.errors import UsageError


@lru_cache(maxsize=2)
def open_street(
    source: str,
    *,
    scene: str | None = None,
    traversals: tuple[str, ...] = (),
    road_map: Path | None = None,
    boxes: str | None = None,
) -> Street:
    """Open a street.

    Args:
        source: ``synth:PRESET[:SEED[:DRIVE]]``, or the folder or URL of a dataset.
        scene: scene of the dataset; None: it has only one.
        traversals: traversals of the dataset; empty: all of the scene.
        road_map: file of the map; None: exact for a synthetic street; for a dataset its recorded map, or a fitted one.
        boxes: layer of boxes ``source@version`` of the dataset; None: it has one at most.

    Raises:
        UsageError: there is no such street, scene, traversal, map or layer.
        DatasetError: the dataset cannot be read.
    """
    if source.startswith(SCHEME):
        from hybridworldsim.simulator.street.of_synth import open_synthetic_street

        if scene is not None or traversals or road_map is not None or boxes is not None:
            raise UsageError(f"{source} has its own scene, traversal, map and boxes", expected="its name alone")
        return open_synthetic_street(source)
    import mirror
    from hybridworldsim.simulator.street.of_dataset import street_of_dataset

    return street_of_dataset(mirror.open(source), scene=scene, traversals=traversals, road_map=road_map, boxes=boxes)
