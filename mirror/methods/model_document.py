"""``reconstruction.json``: identifies a trained model, and decides on which splits it may be tested."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from mirror.dataset.dataset import Dataset
from mirror.dataset.split_document import read_split
from mirror.errors import DatasetError, UsageError
from mirror.protocols.document import Protocol
from mirror.schema.documents import Document
from mirror.schema.files import read_json

DOCUMENT: Final = "reconstruction.json"


class Costs(Document):
    """Costs of a model: training time, size and memory.

    Attributes:
        model_bytes: bytes of all files that rendering needs.
        driven_m: length of the road that the model covers.
        core_s: processor time of training.
        wall_s: elapsed time of training.
    """

    model_bytes: int
    driven_m: float
    core_s: float
    wall_s: float


class Reconstruction(Document):
    """``reconstruction.json`` in the folder of a model.

    Attributes:
        format: always ``mirror-reconstruction``.
        version: version of this document's format.
        method: entry-point name of the method that renders the model.
        scene: id of the reconstructed scene.
        split: split whose training traversals were used.
        trained: ids of these traversals, each with the hash of its recorded data.
        withheld: number of images of training traversals that were not trained on.
        poses: pose layer used for training.
        calibrations: layer of calibrations used for training; renders use it too.
        done: costs; None: training is not finished.
    """

    format: Literal["mirror-reconstruction"] = "mirror-reconstruction"
    version: Literal["1"] = "1"
    method: str
    scene: str
    split: str
    trained: dict[str, str]
    withheld: int = 0
    poses: str = "recorded"
    calibrations: str = "recorded"
    done: Costs | None = None


def read_reconstruction(model: Path) -> Reconstruction:
    """Read the document of a model.

    Raises:
        DatasetError: the folder does not contain a model.
        SchemaError: the document is invalid.
    """
    if not (model / DOCUMENT).is_file():
        raise DatasetError(
            f"the folder has no {DOCUMENT}" if model.is_dir() else "no such folder", file=model,
            expected="the folder of a model, as `mirror reconstruct --out` wrote it",
        )  # fmt: skip
    return read_json(model / DOCUMENT, Reconstruction)


def require_finished(document: Reconstruction, model: Path) -> None:
    """Require that a model is trained to the end.

    Raises:
        DatasetError: its training is not finished.
    """
    if document.done is None:
        raise DatasetError(
            "the model is not trained to the end", file=model, expected="a finished model",
            remedy="run the same `mirror reconstruct` again: it continues where it stopped",
        )  # fmt: skip


def list_trained_traversals(dataset: Dataset, split: str, scene: str) -> dict[str, str]:
    """List the training traversals of a scene, each with the hash of its recorded data."""
    traversals = dataset.where(split=split, role="train", scene=scene).traversals()
    manifests = read_split(dataset.store, split).manifests
    return {traversal: manifests[traversal] for traversal in traversals}


def require_matching_split(dataset: Dataset, split: str, model: Reconstruction) -> None:
    """Check that a model was trained on traversals of a split, with the dataset's poses, and on no held-out one.

    Raises:
        UsageError: the model has other traversals, other poses (its world frame may differ), or was trained on
            traversals that the split holds out.
        DatasetError: the split does not exist.
    """
    document = read_split(dataset.store, split)
    known = {traversal: role for traversal, role in document.assignments.items() if traversal in model.trained}
    place = f"model of {model.scene}, split {model.split}"
    if not known:
        raise UsageError(
            f"split {split} has none of the {len(model.trained)} traversals that the model was trained on", place=place,
            file=dataset.root, expected="the dataset of the training", remedy="name that dataset, or train again",
        )  # fmt: skip
    changed = sorted(traversal for traversal in known if document.manifests[traversal] != model.trained[traversal])
    if changed:
        raise UsageError(
            f"the recorded data of {', '.join(changed)} changed after the training", place=place, file=dataset.root,
            expected="traversals with the same recorded data as in the training", remedy="train again",
        )  # fmt: skip
    if dataset.layers.poses != model.poses:
        raise UsageError(
            f"the model was trained at poses {model.poses}, the dataset is opened with poses {dataset.layers.poses}",
            place=place, file=dataset.root,
            expected="the same poses", remedy=f"open the dataset with poses {model.poses}, or train again",
        )  # fmt: skip
    leaked = sorted(traversal for traversal, role in known.items() if role not in ("train", "unused"))
    if leaked:
        raise UsageError(
            f"the model was trained on {', '.join(leaked)}, which split {split} holds out",
            place=place, file=dataset.root, expected="a model that was not trained on held-out traversals",
            remedy=f"train one: mirror reconstruct {dataset.root} --split {split} --out MODEL",
        )  # fmt: skip


def require_held_out_images(protocol: Protocol, model: Reconstruction) -> None:
    """Check that a model was trained without the scored images, if a protocol scores only training traversals.

    Raises:
        UsageError: the model was trained on the images that the protocol scores.
    """
    recorded = [group.roles for group in protocol.groups if group.ego_shift_m == 0.0]
    if recorded and all(set(roles) == {"train"} for roles in recorded) and not model.withheld:
        raise UsageError(
            f"the model was trained on the images that protocol {protocol.name} scores",
            place=f"model of {model.scene}", expected="a model that was trained without the scored images",
            remedy=f"train one: mirror reconstruct DATASET --split {model.split} --out MODEL --hold-out",
        )  # fmt: skip
