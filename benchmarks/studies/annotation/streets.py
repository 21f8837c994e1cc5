"""The datasets of the experiment, and what each of their drives is for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.studies.annotation.declaration import Streets
from mirror.dataset.dataset import Dataset

_LAYER = "synth"


@dataclass(frozen=True)
class Drives:
    """The drives of one seed.

    Attributes:
        training: drives that are trained on.
        known: unseen drives of scenes that are trained on.
        held_out: drives of scenes that are not trained on.
    """

    training: tuple[str, ...]
    known: tuple[str, ...]
    held_out: tuple[str, ...]


def assign_drives(streets: Streets, seed: int) -> Drives:
    """Assign each drive of a seed its use; `mirror synth` names drives by their scene and their number from 1."""
    from mirror.synth.fleet.presets import PRESETS

    training, known, held_out = list[str](), list[str](), list[str]()
    for place, site in enumerate(PRESETS[streets.preset].sites):
        scene = site.roi.scene_id
        unseen = (seed + place) % streets.traversals
        for number in range(streets.traversals):
            drive = f"{scene}-{number + 1:02d}"
            if seed == streets.seeds[0] and scene in streets.held_out:
                held_out.append(drive)
            else:
                (known if number == unseen else training).append(drive)
    return Drives(tuple(training), tuple(known), tuple(held_out))


def open_streets(folder: Path, seed: int) -> Dataset:
    """Open the dataset of a seed, with its exact boxes."""
    import mirror
    from mirror.annotation.box_layer import box_layers

    dataset = mirror.open(folder / f"dataset-{seed}")
    (layer,) = [name for name in box_layers(dataset) if name.startswith(f"{_LAYER}@")]
    return dataset.with_layers(boxes=layer)


def recordings_of(folder: Path, seed: int) -> Path:
    """Return the folder of the recordings of a seed."""
    return folder / f"recordings-{seed}"
