"""Make the scenes of the study: recordings, dataset, splits, layers."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import mirror
from benchmarks.studies.static_reconstruction.declaration import NOVEL, TRAINING, Declaration
from benchmarks.studies.static_reconstruction.methods import REDUCED_COUNTS, reduced_split
from hybridworldsim.methods.layers import has_estimated_points, layers_for
from hybridworldsim.training.appearance import AppearanceSelector, trained_cameras
from mirror.dataset.dataset import Dataset
from mirror.dataset.layout import manifest_sha256
from mirror.errors import DatasetError
from mirror.methods.plugin import ReconstructionTask
from mirror.progress import ProgressReporter
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.views import plan_views
from mirror.schema.documents import SplitDocument
from mirror.schema.files import read_json, write_json

RECORDINGS: Final = "recordings"
DATASET: Final = "dataset"


def protocol_at(declaration: Declaration, width_px: int) -> Protocol:
    """Return the declared protocol with images of another width."""
    protocol = load_protocol(declaration.protocol)
    return protocol.model_copy(update={"pixels": protocol.pixels.model_copy(update={"max_width_px": width_px})})


def open_scenes(folder: Path) -> Dataset:
    """Open the dataset of a working folder.

    Raises:
        DatasetError: `prepare` has not made it.
    """
    if not (folder / DATASET / "dataset.json").is_file():
        raise DatasetError(
            "no scenes yet", file=folder, remedy=f"python -m benchmarks static_reconstruction prepare --data {folder}"
        )
    return mirror.open(folder / DATASET)


def prepare(
    folder: Path,
    declaration: Declaration,
    scenes: Sequence[str],
    splits: Sequence[str],
    width_px: int,
    progress: ProgressReporter,
) -> None:
    """Make the recordings, dataset, splits and layers that are missing.

    Args:
        folder: working folder of the study.
        declaration: of the study.
        scenes: to make layers of.
        splits: whose training traversals get layers.
        width_px: of the images that stereo matches.
        progress: reports the progress.
    """
    from mirror.cli.main import main

    recordings, dataset = folder / RECORDINGS, folder / DATASET
    if not (recordings / "rois.geojson").is_file():
        _run(main, ["synth", "--out", str(recordings), "--preset", declaration.preset,
                    "--seed", str(declaration.scenes_seed)])  # fmt: skip
    if not (dataset / "index" / "snapshots").is_dir():
        # Beside the recordings lies the folder of exact maps.
        drives = [str(path.parent) for path in sorted(recordings.glob("*/recording.json"))]
        _run(main, ["ingest", *drives, "--rois", str(recordings / "rois.geojson"), "--out", str(dataset),
                    "--licence", "CC0-1.0"])  # fmt: skip
    split = dataset / "splits" / f"{declaration.split}.json"
    if not split.is_file():
        _run(main, ["split", str(dataset), declaration.split, "--seed", str(declaration.split_seed)])
    for count in REDUCED_COUNTS:
        write_reduced_split(mirror.open(dataset), declaration, count)
    for scene in scenes:
        for one in splits:
            layers_for(mirror.open(dataset), make_task(declaration, scene, one, width_px, 1.0, 0), progress)


def require_prepared(
    folder: Path, declaration: Declaration, scenes: Sequence[str], splits: Sequence[str], width_px: int
) -> None:
    """Refuse to run jobs without layers: jobs side by side would make the same layers at the same time.

    Raises:
        DatasetError: some layers are missing.
    """
    dataset = open_scenes(folder)
    for scene in scenes:
        for split in splits:
            if not has_estimated_points(dataset, make_task(declaration, scene, split, width_px, 1.0, 0)):
                raise DatasetError(
                    f"{scene} has no layers of split {split}, {width_px} px", file=folder,
                    remedy="`prepare` with the same --group, --width and --entries",
                )  # fmt: skip


def hash_layers(dataset: Dataset, split: str, scene: str, source: str) -> dict[str, str]:
    """Hash the layers that a model is initialised from: for each kind, the manifests of the training traversals.

    Args:
        dataset: a local dataset.
        split: of the training traversals.
        scene: of the training traversals.
        source: ``source@version``.
    """
    name, _, version = source.partition("@")
    traversals = sorted(dataset.where(split=split, role="train", scene=scene).traversals())
    found = {}
    for kind in ("depth", "masks", "points"):
        folders = [dataset.layout.layer(traversal, kind, name, version) for traversal in traversals]
        there = [manifest_sha256(folder) for folder in folders if folder.is_dir()]
        found[kind] = hashlib.sha256("".join(there).encode()).hexdigest()
    return found


def _run(main: object, words: list[str]) -> None:
    print("$ mirror", *words[:1], "...", flush=True)
    code = main(words)  # type: ignore[operator]
    if code:
        raise DatasetError(f"`mirror {words[0]}` ended with {code}", expected="0")


def write_reduced_split(dataset: Dataset, declaration: Declaration, count: int) -> None:
    """Write a split with the nearest `count` training traversals of each scene and the same held-out ones."""
    name = reduced_split(declaration.split, count)
    path = dataset.layout.root / "splits" / f"{name}.json"
    if path.is_file():
        return
    document = read_json(path.with_name(f"{declaration.split}.json"), SplitDocument)
    roles = dict(document.assignments)
    for scene in dataset.scenes():
        for traversal in _nearest_first(dataset, declaration, scene)[count:]:
            roles[traversal] = "unused"
    write_json(path, document.model_copy(update={"name": name, "assignments": roles}))


def _nearest_first(dataset: Dataset, declaration: Declaration, scene: str) -> list[str]:
    """Training traversals, nearest first: in the order in which the declared policy gives their appearance."""
    plan = plan_views(dataset.where(scene=scene), load_protocol(declaration.protocol), declaration.split)
    held_out = [view for view in plan.views if view.group == NOVEL]
    seen, order = trained_cameras([view for view in plan.views if view.group == TRAINING]), []
    while seen:
        order.append(AppearanceSelector(seen, declaration.policy, held_out).select(held_out[0]).content.traversal_id)
        seen = tuple(one for one in seen if one.traversal_id != order[-1])
    return order


def make_task(
    declaration: Declaration, scene: str, split: str, width_px: int, core_minutes: float, seed: int
) -> ReconstructionTask:
    """Return the reconstruction that a method gets."""
    return ReconstructionTask(
        scene=scene,
        split=split,
        protocol=protocol_at(declaration, width_px),
        core_minutes=core_minutes,
        seed=seed,
        initialise=declaration.initialise,
        threads=1,
    )
