"""``reconstruction.json``: what the folder of a trained model is, and which splits it may be tested on."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.protocols.document import Protocol
from mirror.schema.documents import Document, SplitDocument
from mirror.schema.files import read_json

DOCUMENT: Final = "reconstruction.json"


class Costs(Document):
    """What a model costs.

    Attributes:
        model_bytes: of all that rendering needs.
        driven_m: length of the road that it covers.
        core_s: processor time of training.
        wall_s: time on the wall, of training.
    """

    model_bytes: int
    driven_m: float
    core_s: float
    wall_s: float


class Reconstruction(Document):
    """``reconstruction.json`` in the folder of a trained model: which method renders it.

    Attributes:
        format: always ``mirror-reconstruction``.
        version: of this document.
        method: name of its entry point.
        scene: that was reconstructed.
        split: whose training traversals were looked at.
        trained: these traversals, each with the hash of what was recorded of it.
        withheld: pictures of training traversals that were not learnt from.
        poses: layer of poses that it was trained at.
        done: what it took, once it is done.
    """

    format: Literal["mirror-reconstruction"] = "mirror-reconstruction"
    version: Literal["1"] = "1"
    method: str
    scene: str
    split: str
    trained: dict[str, str]
    withheld: int = 0
    poses: str = "recorded"
    done: Costs | None = None


def read_reconstruction(model: Path) -> Reconstruction:
    """What the model of a folder is.

    Raises:
        DatasetError: the folder holds no model.
        SchemaError: its document is broken.
    """
    if not (model / DOCUMENT).is_file():
        raise DatasetError(
            f"no {DOCUMENT} there" if model.is_dir() else "no such folder", file=model,
            expected="the folder of a model, as `mirror reconstruct --out` wrote it",
        )  # fmt: skip
    return read_json(model / DOCUMENT, Reconstruction)


def list_trained_traversals(dataset: Dataset, split: str, scene: str) -> dict[str, str]:
    """The training traversals of a scene, each with the hash of what was recorded of it."""
    own = dataset.where(split=split, role="train", scene=scene).traversals()
    manifests = _split(dataset, split).manifests
    return {traversal: manifests[traversal] for traversal in own}


def require_matching_split(dataset: Dataset, split: str, model: Reconstruction) -> None:
    """See that a model was trained on traversals that a dataset's split has, and on none that it holds out.

    Raises:
        UsageError: it was not, or at other poses: they may be of another world, or pictures are no test.
        DatasetError: there is no such split.
    """
    document = _split(dataset, split)
    known = {traversal: role for traversal, role in document.assignments.items() if traversal in model.trained}
    place = f"model of {model.scene}, split {model.split}"
    if not known:
        raise UsageError(
            f"none of the {len(model.trained)} traversals that it was trained on is in split {split}", place=place,
            file=dataset.root, expected="the dataset that it was trained on", remedy="name that, or train anew",
        )  # fmt: skip
    changed = sorted(one for one in known if document.manifests[one] != model.trained[one])
    if changed:
        raise UsageError(
            f"{', '.join(changed)} was recorded anew since", place=place, file=dataset.root,
            expected="traversals as they were when it was trained", remedy="train anew",
        )  # fmt: skip
    if dataset.layers.poses != model.poses:
        raise UsageError(
            f"it was trained at poses {model.poses}, these are {dataset.layers.poses}", place=place, file=dataset.root,
            expected="the same poses", remedy=f"from Python: dataset.with_layers(poses={model.poses!r})",
        )  # fmt: skip
    leaked = sorted(one for one, role in known.items() if role not in ("train", "unused"))
    if leaked:
        raise UsageError(
            f"it was trained on {', '.join(leaked)}, which split {split} holds out", place=place, file=dataset.root,
            expected="a model that has not seen the test",
            remedy=f"train one: mirror reconstruct {dataset.root} --split {split} --out MODEL",
        )  # fmt: skip


def require_held_out_images(protocol: Protocol, model: Reconstruction) -> None:
    """See that a model has not learnt from the test, where a protocol tests by pictures of training traversals alone.

    Raises:
        UsageError: it has.
    """
    recorded = [group.roles for group in protocol.groups if group.ego_shift_m == 0.0]
    if recorded and all(set(roles) == {"train"} for roles in recorded) and not model.withheld:
        raise UsageError(
            f"it was trained on the pictures that protocol {protocol.name} asks for", place=f"model of {model.scene}",
            expected="a model that has not seen the test",
            remedy=f"train one: mirror reconstruct DATASET --split {model.split} --out MODEL --hold-out",
        )  # fmt: skip


def _split(dataset: Dataset, name: str) -> SplitDocument:
    # Says what is wrong with a name that there is not.
    dataset.where(split=name)
    return dataset.store.json(f"splits/{name}.json", SplitDocument)
