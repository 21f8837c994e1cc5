"""Makes the scenes of the comparison once: recordings, dataset, splits, layers."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import mirror
from benchmarks.studies.static_reconstruction.declared import NOVEL, TRAINING, Declared
from benchmarks.studies.static_reconstruction.methods import FEWER, fewer
from hybridworldsim.methods.layers import are_made, layers_for
from hybridworldsim.training.appearance import AppearanceSelector, seen_of
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
    folder: Path,
    declaration: Declared,
    scenes: Sequence[str],
    splits: Sequence[str],
    width_px: int,
    watch: ProgressReporter,
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
    for count in FEWER:
        write_fewer(mirror.open(dataset), declaration, count)
    for scene in scenes:
        for one in splits:
            layers_for(mirror.open(dataset), task_of(declaration, scene, one, width_px, 1.0, 0), watch)


def require_prepared(
    folder: Path, declaration: Declared, scenes: Sequence[str], splits: Sequence[str], width_px: int
) -> None:
    """Refuse to run jobs whose layers are not there: side by side they would make them at the same time.

    Raises:
        DatasetError: some are not.
    """
    dataset = opened(folder)
    for scene in scenes:
        for split in splits:
            if not are_made(dataset, task_of(declaration, scene, split, width_px, 1.0, 0)):
                raise DatasetError(
                    f"{scene} has no layers of split {split}, {width_px} px", file=folder,
                    remedy="`prepare` with the same --group, --width and --entries",
                )  # fmt: skip


def layers_of(dataset: Dataset, split: str, scene: str, source: str) -> dict[str, str]:
    """What a model began with: of each kind of layer a hash of the manifests of the training traversals.

    Args:
        dataset: a local one.
        split: whose training traversals.
        scene: of which.
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


def write_fewer(dataset: Dataset, declaration: Declared, count: int) -> None:
    """Write a split with so many training traversals of each scene, the nearest, and the same held-out ones."""
    name = fewer(declaration.split, count)
    path = dataset.layout.root / "splits" / f"{name}.json"
    if path.is_file():
        return
    document = read_json(path.with_name(f"{declaration.split}.json"), SplitDocument)
    roles = dict(document.assignments)
    for scene in dataset.scenes():
        for traversal in _nearest_first(dataset, declaration, scene)[count:]:
            roles[traversal] = "unused"
    write_json(path, document.model_copy(update={"name": name, "assignments": roles}))


def _nearest_first(dataset: Dataset, declaration: Declared, scene: str) -> list[str]:
    """Training traversals, those first whose looks held-out pictures get by the declared policy."""
    plan = plan_views(dataset.where(scene=scene), load_protocol(declaration.protocol), declaration.split)
    held_out = [view for view in plan.views if view.group == NOVEL]
    seen, order = seen_of([view for view in plan.views if view.group == TRAINING]), []
    while seen:
        order.append(AppearanceSelector(seen, declaration.policy, held_out).of(held_out[0]).content.traversal_id)
        seen = tuple(one for one in seen if one.traversal_id != order[-1])
    return order


def task_of(
    declaration: Declared, scene: str, split: str, width_px: int, core_minutes: float, seed: int
) -> ReconstructionTask:
    """What a method is asked for."""
    return ReconstructionTask(
        scene=scene,
        split=split,
        protocol=narrowed(declaration, width_px),
        core_minutes=core_minutes,
        seed=seed,
        initialise=declaration.initialise,
        threads=1,
    )
