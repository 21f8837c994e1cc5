"""The sources of clips: training traversals with boxes and masks, and the static street of each scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow.compute as pc

from hybridworldsim.generation.recorded.windows import MASK_KINDS
from mirror.annotation.box_layer import box_layers, choose_box_layer
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.methods.model import ModelFolder
from mirror.methods.model_document import DOCUMENT, require_matching_split
from mirror.weights.resolve import file_sha256

_EXACT = "exact:"


@dataclass(frozen=True)
class StaticStreet:
    """The static street of a scene.

    Attributes:
        text: folder of a model, or ``exact:PRESET`` of the synthetic street.
        identity: hash or name of everything that its images depend on.
        calibrations: layer of calibrations that it was made with.
        trained: traversals that the model was trained on.
    """

    text: str
    identity: str
    calibrations: str
    trained: tuple[str, ...]

    @property
    def is_model(self) -> bool:
        """Return whether the street is a trained model, not the exact synthetic street."""
        return not self.text.startswith(_EXACT)


@dataclass(frozen=True)
class ClipSources:
    """The sources that clips are made of.

    Attributes:
        split: name of the split.
        boxes: layer of boxes.
        streets: static streets by scene.
        traversals: training traversals of these scenes.
    """

    split: str
    boxes: str
    streets: dict[str, StaticStreet]
    traversals: tuple[str, ...]


def find_sources(
    dataset: Dataset,
    backgrounds: Sequence[str],
    *,
    split: str | None,
    role: str,
    boxes: str | None,
    method: str | None,
) -> ClipSources:
    """Find the sources of clips, and raise an error if one is missing.

    Args:
        dataset: the dataset.
        backgrounds: folders of models of different scenes; or one ``exact:PRESET`` for all scenes.
        split: name of the split; None: that of the first model.
        role: role of the traversals: only those of training are taken.
        boxes: layer of boxes; None: the only one.
        method: ``FILE.py:OBJECT`` of the models' method; None: it is installed.

    Raises:
        UsageError: the role is held out, there is no split or layer of boxes, two models are of one scene, a model does
            not fit the split, or a traversal has no boxes or no masks.
        DatasetError: there is no such split, or no finished model.
    """
    if role != "train":
        raise UsageError(
            f"traversals of the role {role}", place="--role", expected="train: a generator never sees held-out ones",
            remedy="leave out --role, or make a split that trains on them",
        )  # fmt: skip
    if any(text.startswith(_EXACT) for text in backgrounds):
        if len(backgrounds) > 1 or split is None:
            raise UsageError(
                f"{', '.join(backgrounds)} without --split" if split is None else ", ".join(backgrounds),
                place="--background", expected="one exact:PRESET, and --split; or models",
            )  # fmt: skip
        named = dataset.where(split=split, role=role)
        streets = {
            scene: StaticStreet(
                backgrounds[0], backgrounds[0], "recorded", tuple(named.where(scene=scene).traversals())
            )
            for scene in named.scenes()
        }
    else:
        streets, split = _find_models(dataset, backgrounds, split, method)
    view = dataset.where(split=split, role=role, scene=list(streets))
    if not view.traversals():
        raise UsageError(
            f"split {split} trains on no traversal of {', '.join(streets) or 'the dataset'}", place="--split",
            expected="a split with training traversals of the models' scenes",
        )  # fmt: skip
    layer = _choose_boxes(view, dataset, boxes)
    _require_layers(view, dataset, layer)
    return ClipSources(split, layer, streets, tuple(view.traversals()))


def _find_models(
    dataset: Dataset, folders: Sequence[str], split: str | None, method: str | None
) -> tuple[dict[str, StaticStreet], str]:
    streets: dict[str, StaticStreet] = {}
    models = [ModelFolder.read(Path(folder), method) for folder in folders]
    split = split or models[0].document.split
    for model in models:
        document = model.document
        require_matching_split(dataset, split, document)
        if document.scene in streets:
            raise UsageError(
                f"{model.folder} and {streets[document.scene].text} are both of scene {document.scene}",
                place="--background", expected="models of different scenes",
            )  # fmt: skip
        if document.scene not in dataset.scenes():
            raise UsageError(
                f"the static model is of scene {document.scene}", file=model.folder, place="--background",
                expected=f"of {', '.join(dataset.scenes())}",
            )  # fmt: skip
        streets[document.scene] = StaticStreet(
            str(model.folder), file_sha256(model.folder / DOCUMENT), document.calibrations, tuple(document.trained)
        )
    return streets, split


def _choose_boxes(view: Dataset, dataset: Dataset, boxes: str | None) -> str:
    if not box_layers(view):
        raise UsageError(
            "no layer of boxes", file=dataset.root, place="--boxes", expected="boxes of road users",
            remedy=f"make one: mirror annotate {dataset.root}",
        )  # fmt: skip
    return choose_box_layer(view, boxes)


def _require_layers(view: Dataset, dataset: Dataset, boxes: str) -> None:
    """Require that all traversals have the layer of boxes, and masks of road users."""
    rows = view.table("traversals", ["traversal_id", "layers"]).to_pylist()
    lacking = [row["traversal_id"] for row in rows if f"boxes/{boxes}" not in row["layers"]]
    if lacking:
        raise UsageError(
            f"{len(lacking)} of {len(rows)} training traversals have no boxes {boxes}", file=dataset.root,
            place=lacking[0], expected="boxes of road users in all of them",
            remedy="name another layer with --boxes, or annotate them: mirror annotate",
        )  # fmt: skip
    masked = list_masked(view)
    lacking = [row["traversal_id"] for row in rows if row["traversal_id"] not in masked]
    if lacking:
        raise UsageError(
            f"{len(lacking)} of {len(rows)} training traversals have no masks of road users", file=dataset.root,
            place=lacking[0], expected=f"a layer of masks of the kind {' or '.join(MASK_KINDS)}",
            remedy=f"make it: mirror annotate masks {dataset.root} --boxes {boxes}",
        )  # fmt: skip


def list_masked(view: Dataset) -> frozenset[str]:
    """Return the traversals of a view that have masks of road users, even if the masks are empty."""
    rows = view.table("traversals", ["traversal_id", "layers"]).to_pylist()
    having = {row["traversal_id"] for row in rows if any(layer.startswith("masks/") for layer in row["layers"])}
    masks = view.table("masks", ["traversal_id", "kind"])
    kinds = {name: set[str]() for name in having}
    for batch in masks.to_batches():
        # One batch is one traversal, or a part of one.
        for name in pc.unique(batch.column(0)).to_pylist():
            kinds[name] |= set(pc.unique(batch.column(1)).to_pylist())
    return frozenset(name for name, own in kinds.items() if not own or own & set(MASK_KINDS))
