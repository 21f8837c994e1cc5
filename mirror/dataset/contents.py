"""The contents of a view's samples: determined once from the index, so that all samples have the same shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import pyarrow.compute as pc

from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.query.arrow import is_member, to_arrow_mask, to_numpy
from mirror.dataset.query.filters import Filters
from mirror.dataset.query.select import select_parts
from mirror.dataset.raster import Resize, resized_shape, validate_resize
from mirror.dataset.traversal import layer_names
from mirror.errors import UsageError
from mirror.schema.documents import Rig

ImageLayout = Literal["chw", "hwc"]

MASK_KINDS: Final = ("dynamic", "ego", "sky", "instance", "redaction")


@dataclass(frozen=True)
class SampleContents:
    """The contents of one sample.

    Attributes:
        cameras: names along the camera axis.
        is_single_camera: True: the samples have no camera axis.
        layout: position of the channels in image tensors.
        undistort: whether images are mapped to a pinhole.
        resize: argument of `mirror.dataset.raster.resized_shape`.
        boxes: number of rows in the tensors of boxes; None: samples have no boxes.
        categories: categories of boxes, in the order of their numbers.
        masks: names ``kind`` or ``kind/source@version``.
        verify: whether images are compared with their hashes.
    """

    cameras: tuple[str, ...]
    is_single_camera: bool
    layout: ImageLayout
    undistort: bool
    resize: Resize | None
    boxes: int | None
    categories: tuple[str, ...]
    masks: tuple[str, ...]
    verify: bool


def resolve_contents(
    dataset: Dataset,
    cameras: str | Sequence[str] | None,
    *,
    undistort: bool,
    resize: Resize | None,
    layout: ImageLayout,
    boxes: bool,
    categories: Sequence[str] | None,
    masks: Sequence[str] | None,
    verify: bool,
) -> SampleContents:
    """Determine the contents of samples; arguments that are None take their values from the view.

    The arguments are those of `FrameDataset`.

    Raises:
        UsageError: the view has no images, or an argument does not fit it.
    """
    if layout not in ("chw", "hwc"):
        raise UsageError(f"layout={layout!r}", expected="'chw' or 'hwc'")
    if categories is not None and (not boxes or isinstance(categories, str)):
        raise UsageError(f"categories={categories!r} with boxes={boxes}", expected="a list of names, and boxes=True")
    named = _cameras(dataset, cameras)
    known, count = _boxes(dataset) if boxes else ((), None)
    return SampleContents(
        cameras=named,
        is_single_camera=isinstance(cameras, str),
        layout=layout,
        undistort=bool(undistort),
        resize=validate_resize(resize),
        boxes=count,
        categories=known if categories is None else tuple(categories),
        masks=_masks(dataset, masks),
        verify=verify,
    )


def raster_shapes(dataset: Dataset, contents: SampleContents) -> dict[str, tuple[int, int]]:
    """Return the height and width of tensors that fit all images of a traversal, by traversal id."""
    view = _whole_traversals(dataset).where(camera=contents.cameras)
    table = view.table("images", ["traversal_id", "height_px", "width_px"])
    rows = table.group_by(["traversal_id", "height_px", "width_px"]).aggregate([]).to_pylist()
    shapes: dict[str, tuple[int, int]] = {}
    for row in rows:
        height, width = resized_shape((row["height_px"], row["width_px"]), contents.resize)
        before = shapes.get(row["traversal_id"], (0, 0))
        shapes[row["traversal_id"]] = (max(before[0], height), max(before[1], width))
    return shapes


def _cameras(dataset: Dataset, cameras: str | Sequence[str] | None) -> tuple[str, ...]:
    known = dataset.cameras()
    if not known:
        raise UsageError("the view has no images", remedy="choose scenes or drives that were recorded with cameras")
    chosen = known if cameras is None else [cameras] if isinstance(cameras, str) else list(cameras)
    for camera in chosen:
        if camera not in known:
            raise UsageError(f"no camera {camera!r} in the view", expected=f"of {', '.join(known)}")
    if not chosen or len(set(chosen)) < len(chosen):
        raise UsageError(f"cameras {chosen}", expected="at least one, each once")
    return tuple(chosen)


def _boxes(dataset: Dataset) -> tuple[tuple[str, ...], int]:
    """Categories, and the largest number of boxes at one time, in the whole dataset, so that all views agree."""
    catalog, chosen = dataset.catalog, dataset.layers.boxes
    categories: set[str] = set()
    largest = 0
    for part in select_parts(catalog, Filters(), "boxes"):
        names = ["timestamp_ns", "category", "source", "source_version"]
        stamps, category, source, version = catalog.columns.read(part.path, part.number, names)
        if chosen is None:
            in_layer = np.ones(len(stamps), np.bool_)
        else:
            in_layer = is_member(layer_names(source, version), frozenset([chosen]))
        categories.update(pc.unique(category.filter(to_arrow_mask(in_layer))).to_pylist())
        largest = max(largest, int(_run_lengths(to_numpy(stamps)[in_layer]).max(initial=0)))
    return tuple(sorted(categories)), largest


def _run_lengths(values: Int64) -> Int64:
    """Lengths of the runs of equal values."""
    ends = np.flatnonzero(np.diff(values, append=values[-1:] + 1))
    return np.diff(ends, prepend=-1)


def _masks(dataset: Dataset, masks: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the masks of samples; default: every kind in the whole dataset."""
    if isinstance(masks, str):
        raise UsageError(f"masks={masks!r}", expected=f"a list of names, such as [{masks!r}]")
    everything = replace(dataset, filters=Filters())
    table = everything.table("masks", ["kind", "source", "source_version"])
    rows = table.group_by(["kind", "source", "source_version"]).aggregate([]).to_pylist()
    kinds = {row["kind"] for row in rows}
    rigs = set(everything.table("traversals", ["rig_id"]).column(0).to_pylist()) - {None}
    if any(camera.static_mask for rig_id in rigs for camera in dataset.store.json(f"rigs/{rig_id}.json", Rig).cameras):
        kinds.add("ego")
    if masks is None:
        return tuple(kind for kind in MASK_KINDS if kind in kinds)
    known = kinds | {f"{row['kind']}/{row['source']}@{row['source_version']}" for row in rows}
    for name in masks:
        if name not in known:
            raise UsageError(
                f"no masks {name!r} in the dataset",
                expected=f"of {', '.join(sorted(known))}" if known else "none: masks=[]",
            )
    return tuple(masks)


def _whole_traversals(dataset: Dataset) -> Dataset:
    """A view of the complete traversals of a view, without its filters of time, place and camera."""
    return replace(dataset, filters=Filters(traversal=frozenset(dataset.traversals())))
