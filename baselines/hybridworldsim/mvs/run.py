"""Initialises a reconstruction: writes depth maps, points and sky masks of a split's training traversals as layers."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Set
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.methods import SPARSE, make_estimator
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.plane_sweep import estimate_bytes
from hybridworldsim.mvs.writing.layers import InitialisationLayers
from hybridworldsim.mvs.writing.scene import SceneInitialisation
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.unfinished_work import remove_work
from mirror.dataset.writing import writing_layers
from mirror.devices import CPU, require_memory
from mirror.methods.training_images import ImageKey
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.hashing import hash_document


@dataclass(frozen=True)
class InitialisationReport:
    """The result of an initialisation.

    Attributes:
        layer: ``source@version`` of the layers.
        written: traversals that got layers.
        kept: traversals that had their layers already.
        images: number of images with newly estimated depth.
        known_share: share of the static pixels with a confirmed depth, over the depth maps that were written.
        points: number of points of the scenes that were written, by kind.
        ground_sigma_m: robust standard deviation of the driven positions from the fitted ground, by scene.
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
    withheld: Set[ImageKey] = frozenset(),
    device: str = CPU,
    progress: ProgressReporter | None = None,
) -> InitialisationReport:
    """Write layers of depth, points and sky masks for the training traversals of a split.

    Neither images nor poses of held-out traversals are read. An interrupted run continues where it stopped, with the
    same result. Memory: at most 512 depth maps and 256 images, and the points of one scene; ``sparse`` holds the
    descriptors of all images of a scene.

    Args:
        dataset: a local dataset, or a view of it.
        split: name of the split.
        method: ``plane-sweep``, ``mvsnet``, ``patchmatchnet``, or ``sparse``, which triangulates features and makes no
            depth. It is the source name of the layers.
        width_px: greatest width of the rasters; None: as in the options.
        weights: file with the weights of a learned method; None: `WeightResolver` finds the file.
        estimator: replaces the estimator that ``method`` names; its ``repr`` must differ between different estimators.
        version: version of the layers; None: the name of the split.
        options: the options; None: the defaults.
        withheld: images of training traversals that are not opened; their vehicle's poses still enter the ground.
        device: where depth is estimated and compared, and the sky found, as torch names it; ``sparse`` and the ground
            are computed on the CPU.
        progress: receives the phases and their progress.

    Raises:
        DatasetError: layers of this name exist, and were made from other traversals or with other options; or a GPU has
            too little memory.
        UsageError: the split or the method does not exist, or the dataset is not local.
    """
    chosen = options or InitialisationOptions()
    if width_px is not None:
        chosen = replace(chosen, width_px=width_px)
    require_layer_name(method, version or split)
    view = dataset.where(split=split, role="train")
    if method == SPARSE and estimator is None:
        kinds: tuple[str, ...] = ("points",)
    else:
        if device != CPU:
            require_memory(device, estimate_bytes(chosen.width_px), "a smaller --width-px, or --device cpu")
        estimator = estimator or make_estimator(method, weights, device)
        kinds = ("depth", "masks", "points") if chosen.sky else ("depth", "points")
    reporter = progress or NullProgress()
    input_hashes = _hash_inputs(view, chosen, estimator, withheld)
    layers = InitialisationLayers(view.layout, method, version or split, kinds, input_hashes)
    if all(layers.is_complete(traversal_id) for traversal_id in view.traversals()):
        # Nothing is written, so no lock is needed: parallel runs may share complete layers.
        return _initialise_scenes(view, layers, chosen, estimator, withheld, device, reporter)
    with writing_layers(view.layout):
        return _initialise_scenes(view, layers, chosen, estimator, withheld, device, reporter)


def _hash_inputs(
    view: Dataset, options: InitialisationOptions, estimator: DepthEstimator | None, withheld: Set[ImageKey]
) -> dict[str, str]:
    """Hash everything that the layers of a view depend on; the keys are part of the manifests."""
    hashes = {"options": hash_document(asdict(options)), "estimator": _digest(repr(estimator))}
    if withheld:
        hashes["withheld"] = hash_document(sorted(withheld))
    choice = {key: value for key, value in asdict(view.layers).items() if key not in ("depth", "points")}
    hashes["layers"] = hash_document(choice)
    table = view.table("traversals", ["traversal_id", "layers"])
    rows = zip(*(column.to_pylist() for column in table.columns))
    names = {(traversal_id, name) for traversal_id, layers in rows for name in layers}
    chosen = {f"poses/{view.layers.poses}", f"calibrations/{view.layers.calibrations}"}
    mask_layers = {f"masks/{name}" for name in _find_mask_layers(view)}
    contents = ContentHashes(view.store)
    for traversal_id in view.traversals():
        read = [
            name
            for owner, name in sorted(names)
            if owner == traversal_id and (name.startswith("boxes/") or name in chosen | mask_layers)
        ]
        hashes |= contents.traversal(traversal_id, read)
    return hashes


def _find_mask_layers(view: Dataset) -> set[str]:
    """Find the layers of masks that are inputs: of road users, the own vehicle and redacted pixels, not of the sky."""
    columns = view.table("masks", ["kind", "source", "source_version"]).columns
    rows = set(zip(*(column.to_pylist() for column in columns)))
    return {f"{source}@{version}" for kind, source, version in rows if kind in ("ego", "dynamic", "redaction")}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _initialise_scenes(
    view: Dataset,
    layers: InitialisationLayers,
    options: InitialisationOptions,
    estimator: DepthEstimator | None,
    withheld: Set[ImageKey],
    device: str,
    progress: ProgressReporter,
) -> InitialisationReport:
    """Initialise each scene that has incomplete layers."""
    kept = tuple(traversal_id for traversal_id in view.traversals() if layers.is_complete(traversal_id))
    counts: dict[str, int] = dict.fromkeys(("ground", "background", "far"), 0)
    sigma: dict[str, float] = {}
    images, known, static = 0, 0, 0
    for name in view.scenes():
        scene_view = view.where(scene=name)
        if set(scene_view.traversals()) <= set(kept):
            continue
        scene = SceneInitialisation(scene_view, layers, options, withheld, progress, device)
        if estimator is None:
            clouds = scene.triangulate()
        else:
            images += scene.estimate(estimator)
            clouds, pixels = scene.confirm()
            known, static = known + pixels.known, static + pixels.static
        ground = scene.write_points(clouds)
        sigma[name] = ground.sigma_m
        for kind, count in scene.counts.items():
            counts[kind] += count
    remove_work(layers.work_folder)
    written = tuple(traversal_id for traversal_id in view.traversals() if traversal_id not in kept)
    return InitialisationReport(layers.name, written, kept, images, known / static if static else 0.0, counts, sigma)
