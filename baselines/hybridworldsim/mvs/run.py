"""Initialises a reconstruction: depth maps, points and sky masks of a split's training traversals, as layers."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Set
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Final

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.methods import SPARSE, make_estimator
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.writing.layers import InitialisationLayers
from hybridworldsim.mvs.writing.scene import SceneInitialisation
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layout import read_manifest
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError
from mirror.methods.training_images import Picture
from mirror.progress import NullProgress, ProgressReporter

_LOOKED_AT: Final = ("poses", "calibrations", "boxes")
"""Kinds of layers that say what is matched, and from where; masks do so too."""


@dataclass(frozen=True)
class InitialisationReport:
    """What an initialisation did.

    Attributes:
        layer: ``source@version`` of the layers.
        written: traversals of which layers were written.
        kept: traversals whose layers were there already.
        images: number of images of which depth was estimated.
        known_share: share of the static pixels of the maps written that have a confirmed depth.
        points: points of the scenes written, by kind.
        ground_sigma_m: how far the driven lines are from the ground that was fitted, by scene.
    """

    layer: str
    written: tuple[str, ...]
    kept: tuple[str, ...]
    images: int
    known_share: float
    points: Mapping[str, int]
    ground_sigma_m: Mapping[str, float] = field(default_factory=dict)


def initialise(
    dataset: Dataset,
    split: str,
    *,
    method: str = "plane-sweep",
    width_px: int | None = None,
    weights: Path | None = None,
    estimator: DepthEstimator | None = None,
    version: str | None = None,
    options: InitialisationOptions | None = None,
    withheld: Set[Picture] = frozenset(),
    progress: ProgressReporter | None = None,
) -> InitialisationReport:
    """Write layers of depth, points and sky masks for the training traversals of a split.

    Held-out traversals are not read: neither their pictures nor their poses. A run that was interrupted goes on where
    it stopped, and the outcome is the same. Memory: at most 512 depth maps and 256 pictures, and the points of one
    scene; ``sparse`` holds the descriptors of all its pictures.

    Args:
        dataset: a local dataset, or a part of it.
        split: its split.
        method: ``plane-sweep``, ``mvsnet``, ``patchmatchnet``, or ``sparse``: no depth, features are triangulated. It
            names the layers.
        width_px: widest raster of the pictures; None: that of the options.
        weights: where the weights of a learned method lie; None: where weights are looked for.
        estimator: of depth, in the place of that which ``method`` names; its ``repr`` must tell it from others.
        version: of the layers; None: the name of the split, as other training traversals make other layers.
        options: how; None: the defaults.
        withheld: pictures of training traversals that are not opened either; of their vehicle's poses the ground is
            still told.
        progress: told of the phases.

    Raises:
        DatasetError: layers of that name are there, but were made of other traversals or in another way.
        UsageError: there is no such split or method, or the dataset is not local.
    """
    chosen = options or InitialisationOptions()
    if width_px is not None:
        chosen = replace(chosen, width_px=width_px)
    view = dataset.where(split=split, role="train")
    if method == SPARSE and estimator is None:
        kinds: tuple[str, ...] = ("points",)
    else:
        estimator = estimator or make_estimator(method, weights)
        kinds = ("depth", "masks", "points") if chosen.sky else ("depth", "points")
    told = progress or NullProgress()
    made_of = _made_of(view, chosen, estimator, withheld)
    layers = InitialisationLayers(view.layout, method, version or split, kinds, made_of)
    if all(layers.complete(one) for one in view.traversals()):
        # Nothing is written, so that runs side by side may share what is there.
        return _all_scenes(view, layers, chosen, estimator, withheld, told)
    with writer_lock(view.layout, wait=False):
        try:
            report = _all_scenes(view, layers, chosen, estimator, withheld, told)
        finally:
            # Of what is whole already, too, where it is interrupted: the dataset opens, and the next run goes on.
            told.start("index", 1)
            build_index(view.layout.root)
            told.advance(1)
    return report


def _made_of(
    view: Dataset, options: InitialisationOptions, estimator: DepthEstimator | None, withheld: Set[Picture]
) -> dict[str, str]:
    """Hashes of all that the layers of a view depend on."""
    hashes = {"options": _digest(json.dumps(asdict(options), sort_keys=True)), "estimator": _digest(repr(estimator))}
    if withheld:
        hashes["withheld"] = _digest(json.dumps(sorted(withheld)))
    choice = {key: value for key, value in asdict(view.layers).items() if key not in ("depth", "points")}
    hashes["layers"] = _digest(json.dumps(choice, sort_keys=True))
    table = view.table("traversals", ["traversal_id", "layers"])
    names = {(key, name) for key, own in zip(*(one.to_pylist() for one in table.columns)) for name in own}
    masking = {f"masks/{name}" for name in _masking(view)}
    for traversal_id in view.traversals():
        hashes[f"traversal:{traversal_id}"] = _content(view.layout.recorded(traversal_id))
    for traversal_id, name in sorted(names):
        kind, _, made = name.partition("/")
        if kind in _LOOKED_AT or name in masking:
            source, _, version = made.partition("@")
            hashes[f"{name}:{traversal_id}"] = _content(view.layout.layer(traversal_id, kind, source, version))
    return hashes


def _masking(view: Dataset) -> set[str]:
    """Layers of masks of road users or vehicles; those of the sky are made here."""
    columns = view.table("masks", ["kind", "source", "source_version"]).columns
    rows = set(zip(*(column.to_pylist() for column in columns)))
    return {f"{source}@{version}" for kind, source, version in rows if kind in ("ego", "dynamic")}


def _content(folder: Path) -> str:
    manifest = read_manifest(folder)
    if manifest is None:
        raise DatasetError("not complete", file=folder, remedy="mirror check names what is missing")
    return manifest.content


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _all_scenes(
    view: Dataset,
    layers: InitialisationLayers,
    options: InitialisationOptions,
    estimator: DepthEstimator | None,
    withheld: Set[Picture],
    progress: ProgressReporter,
) -> InitialisationReport:
    kept = tuple(one for one in view.traversals() if layers.complete(one))
    counts: dict[str, int] = dict.fromkeys(("ground", "background", "far"), 0)
    sigma: dict[str, float] = {}
    pictures, known, static = 0, 0, 0
    for name in view.scenes():
        own = view.where(scene=name)
        if all(one in kept for one in own.traversals()):
            continue
        scene = SceneInitialisation(own, layers, options, withheld, progress)
        if estimator is None:
            clouds = scene.triangulate()
        else:
            pictures += scene.estimate(estimator)
            clouds, share = scene.confirm()
            known, static = known + share[0], static + share[1]
        ground = scene.write_points(clouds)
        sigma[name] = ground.sigma_m
        for kind, count in scene.counts.items():
            counts[kind] += count
    # Another run that found all layers complete may do the same at this moment.
    shutil.rmtree(layers.work, ignore_errors=True)
    written = tuple(one for one in view.traversals() if one not in kept)
    return InitialisationReport(layers.name, written, kept, pictures, known / static if static else 0.0, counts, sigma)
