"""Time and error of overlaps of boxes and of detection scores, for MIRROR and its peers.

Errors: for the raster the mean excess of its pixels over the polygon's area, in percent, over random subpixel positions
and rotations; for overlaps in space the largest difference from 60-digit arithmetic; for detection the number of
values, of all curves and figures, that differ in any bit from loops over the definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from benchmarks.report import Peer, Row, best_ms
from mirror.arrays import AnyArray, Float64
from mirror.geometry import Poses, quaternion_multiply
from mirror.metrics.boxes import box_iou_3d, polygon_area, polygon_mask
from mirror.metrics.detection import DETECTION_CVPR_2019, TP_ERRORS, matching_tables, score_tables
from tests.metrics.boxes.reference import CAR, exact_iou
from tests.metrics.detection.reference import evaluate
from tests.metrics.detection.scenes import random_scene

PAIRS = 100_000
CHECKED = 200
FEWER = 500
# Bars: 250 000 pairs per second where shapely reaches 49 000; 0.1 s of matching where loops over boxes take 2.99 s.


def rows() -> Iterator[Row]:
    """Yield the rows of this group."""
    for width, height, count in ((12, 9, 20_000), (30, 20, 20_000), (80, 60, 5_000), (300, 200, 500)):
        yield raster(width, height, count)
    first, second = boxes(PAIRS, 0), boxes(PAIRS, 1)
    truth = exact(*first, *second)
    yield upright(first, second, truth)
    yield tilted(first, second, truth)
    yield matching()


Boxes: TypeAlias = tuple[Poses, Float64]


def raster(width: int, height: int, count: int) -> Row:
    generator = np.random.default_rng(0)
    shape = CAR * (width, height)
    angles, shifts = generator.uniform(-0.3, 0.3, count), generator.uniform(0.0, 1.0, (count, 2))
    placed = []
    for angle, shift in zip(angles, shifts):
        turned = shape @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        placed.append(turned - turned.min(axis=0) + 2.0 + shift)
    side = int(np.ceil(np.max(placed))) + 2

    def measure(fill: Callable[[Float64], AnyArray], part: list[Float64]) -> tuple[float, float]:
        pixels = sum(np.count_nonzero(fill(polygon)) for polygon in part)
        ms = best_ms(lambda: [fill(polygon) for polygon in part[:100]]) / 100.0
        return ms, 100.0 * abs(pixels / (len(part) * polygon_area(shape)) - 1.0)

    def opencv(polygon: Float64) -> AnyArray:
        import cv2

        corners = np.rint(polygon * 16.0 - 8.0).astype(np.int32)
        return np.asarray(cv2.fillConvexPoly(np.zeros((side, side), np.uint8), corners, 1, cv2.LINE_8, 4))

    peers = [Peer("cv2.fillConvexPoly", *measure(opencv, placed[:FEWER]))]
    try:
        from skimage.draw import polygon2mask
    except ModuleNotFoundError:
        pass
    else:

        def skimage(polygon: Float64) -> AnyArray:
            return np.asarray(polygon2mask((side, side), polygon[:, ::-1] - 0.5))

        peers.append(Peer("skimage", *measure(skimage, placed[:FEWER])))
    ms, error = measure(lambda polygon: polygon_mask(polygon, side, side), placed)
    return Row(f"box raster, {count} placements", f"{width}x{height} px", ms, error, tuple(peers), "%", error_bar=0.1)


def boxes(count: int, seed: int) -> tuple[Poses, Float64]:
    generator = np.random.default_rng(seed)
    half = generator.uniform(-np.pi, np.pi, count) / 2
    rotation = np.stack((np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)), axis=-1)
    centre = generator.normal(size=(count, 3)) * (1.5, 1.5, 0.5)
    return Poses(rotation, centre), np.exp(generator.uniform(-0.5, 1.8, (count, 3)))


def exact(first: Poses, lwh: Float64, second: Poses, lwh2: Float64) -> Float64:
    """Return the overlaps of the first pairs in 60-digit arithmetic."""
    single = [slice(row, row + 1) for row in range(CHECKED)]
    return np.array([exact_iou(first[row], lwh[row], second[row], lwh2[row]) for row in single])


def upright(one: Boxes, other: Boxes, truth: Float64) -> Row:
    (first, lwh), (second, lwh2) = one, other

    def error(values: Float64) -> float:
        return float(np.abs(values[:CHECKED] - truth).max())

    fewer = PAIRS // 10

    def shapely() -> Float64:
        import shapely as library

        outlines = [library.polygons(outline(pose[:fewer], size[:fewer])) for pose, size in (one, other)]
        area = library.area(library.intersection(*outlines))
        z, z2, h, h2 = (values[:fewer, 2] for values in (first.translation, second.translation, lwh / 2, lwh2 / 2))
        shared = area * np.maximum(np.minimum(z + h, z2 + h2) - np.maximum(z - h, z2 - h2), 0.0)
        return np.asarray(shared / (lwh[:fewer].prod(axis=1) + lwh2[:fewer].prod(axis=1) - shared))

    peer = Peer("shapely, vectorised", best_ms(shapely, 1) * 10, error(shapely()))
    ours = box_iou_3d(first, lwh, second, lwh2)
    ms = best_ms(lambda: box_iou_3d(first, lwh, second, lwh2))
    return Row(
        "3D IoU, upright", f"{PAIRS} pairs", ms, error(ours), (peer,), bar=peer.ms * 49.0 / 250.0, error_bar=1e-12
    )


def outline(pose: Poses, lwh: Float64) -> Float64:
    """Return the corners (N, 4, 2) in the ground plane."""
    from mirror.geometry import corners

    return np.ascontiguousarray(corners(pose, lwh)[:, [0, 1, 5, 4], :2])


def tilted(one: Boxes, other: Boxes, truth: Float64) -> Row:
    """Permute the axes of boxes, so that their z axes are no longer parallel."""
    (first, lwh), (second, lwh2) = ((pose[: PAIRS // 10], size[: PAIRS // 10]) for pose, size in (one, other))
    turned = Poses(quaternion_multiply(second.rotation, [0.5, 0.5, 0.5, 0.5]), second.translation)
    swapped = np.ascontiguousarray(lwh2[:, [1, 2, 0]])
    error = float(np.abs(box_iou_3d(first, lwh, turned, swapped)[:CHECKED] - truth).max())
    ms = best_ms(lambda: box_iou_3d(first, lwh, turned, swapped))
    return Row("3D IoU, any orientation", f"{PAIRS // 10} pairs", ms, error, error_bar=1e-12)


def matching() -> Row:
    truth, predictions = random_scene(200, 30, 100)
    config = DETECTION_CVPR_2019
    tables = matching_tables(truth, predictions, config)
    build = best_ms(lambda: matching_tables(truth, predictions, config))
    ms = best_ms(lambda: score_tables(tables, truth, predictions, config, absent="devkit"))
    loops = best_ms(lambda: evaluate(truth, predictions, config), 1)
    ours, expected = (
        score_tables(tables, truth, predictions, config, absent="devkit"),
        evaluate(truth, predictions, config),
    )
    differ = sum(
        int(np.count_nonzero(found != expected["curves"][key][name]))
        for key, curve in ours.curves.items()
        for name, found in {"precision": curve.precision, "confidence": curve.confidence, **curve.errors}.items()
    )
    differ += int(float(ours.mean_ap) != expected["mean_ap"]) + int(float(ours.nds) != expected["nds"])
    differ += sum(float(ours.tp_errors[name]) != expected["tp_errors"][name] for name in TP_ERRORS)
    peers = (Peer("loops over boxes", loops), Peer("nuscenes-devkit 1.2.0, quoted", 2990.0))
    return Row(
        f"nuScenes scores (table: {build:.0f} ms)",
        "200 x (30, 100)",
        ms,
        float(differ),
        peers,
        "values",
        bar=loops * 0.1 / 2.99,
        error_bar=1.0,
    )
