"""Makes the scenes of the comparison once: recordings, dataset, splits, layers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import mirror
from benchmarks._reconstruction.declared import Declared
from hybridworldsim.methods.layers import layers_for
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.evaluation.methods import Task
from mirror.evaluation.progress import Watch
from mirror.evaluation.protocol import Protocol, load_protocol
from mirror.schema.documents import SplitDocument
from mirror.schema.files import read_json, write_json

RECORDINGS: Final = "recordings"
DATASET: Final = "dataset"


def narrowed(declaration: Declared, width_px: int) -> Protocol:
    """The declared protocol at a width."""
    protocol = load_protocol(declaration.protocol)
    return protocol.model_copy(update={"pixels": protocol.pixels.model_copy(update={"max_width_px": width_px})})


def opened(folder: Path) -> Dataset:
    """The dataset of the comparison.

    Raises:
        DatasetError: it has not been made.
    """
    if not (folder / DATASET / "dataset.json").is_file():
        raise DatasetError(
            "no scenes yet", file=folder, remedy=f"python -m benchmarks reconstruction prepare --data {folder}"
        )
    return mirror.open(folder / DATASET)


def prepare(
    folder: Path, declaration: Declared, scenes: Sequence[str], splits: Sequence[str], width_px: int, watch: Watch
) -> None:
    """Make what is not there yet.

    Args:
        folder: of the comparison.
        declaration: what is made.
        scenes: that get layers.
        splits: whose training traversals get them.
        width_px: of the pictures that are matched.
        watch: told how it goes.
    """
    from mirror.cli.main import main

    recordings, dataset = folder / RECORDINGS, folder / DATASET
    if not (recordings / "rois.geojson").is_file():
        _run(main, ["synth", "--out", str(recordings), "--preset", declaration.preset,
                    "--seed", str(declaration.scenes_seed)])  # fmt: skip
    if not (dataset / "index" / "manifest.json").is_file():
        drives = [str(path) for path in sorted(recordings.iterdir()) if path.is_dir()]
        _run(main, ["ingest", *drives, "--rois", str(recordings / "rois.geojson"), "--out", str(dataset),
                    "--licence", "CC0-1.0"])  # fmt: skip
    split = dataset / "splits" / f"{declaration.split}.json"
    if not split.is_file():
        _run(main, ["split", str(dataset), declaration.split, "--seed", str(declaration.split_seed)])
    for count in (1, 2):
        _fewer(split, count)
    for scene in scenes:
        for one in splits:
            layers_for(mirror.open(dataset), task_of(declaration, scene, one, width_px, 1.0, 0), watch)


def _run(main: object, words: list[str]) -> None:
    print("$ mirror", *words[:1], "...", flush=True)
    code = main(words)  # type: ignore[operator]
    if code:
        raise DatasetError(f"`mirror {words[0]}` ended with {code}", expected="0")


def _fewer(split: Path, count: int) -> None:
    """A split with the first so many training traversals of each scene, and the same held-out ones."""
    document = read_json(split, SplitDocument)
    kept: dict[str, int] = {}
    roles = dict(document.assignments)
    for traversal, role in sorted(document.assignments.items()):
        scene = traversal.partition(".")[0]
        if role == "train":
            kept[scene] = kept.get(scene, 0) + 1
            roles[traversal] = "train" if kept[scene] <= count else "unused"
    name = f"{document.name}-{count}"
    write_json(split.with_name(f"{name}.json"), document.model_copy(update={"name": name, "assignments": roles}))


def task_of(declaration: Declared, scene: str, split: str, width_px: int, core_minutes: float, seed: int) -> Task:
    """What a method is asked for."""
    return Task(
        scene=scene,
        split=split,
        protocol=narrowed(declaration, width_px),
        core_minutes=core_minutes,
        seed=seed,
        initialise=declaration.initialise,
        threads=1,
    )
