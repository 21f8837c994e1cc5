"""The nuScenes detection metrics as loops over boxes, from their definitions, one box and one number at a time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mirror.arrays import Float64
from mirror.metrics.detection import DetectionBoxes, DetectionConfig

Row = dict[str, Any]


def rows(boxes: DetectionBoxes) -> list[Row]:
    return [
        {
            "sample": boxes.sample[row],
            "category": boxes.category[row],
            "centre": boxes.centre_m[row, :2],
            "size": boxes.lwh_m[row],
            "yaw": float(boxes.yaw_rad[row]),
            "velocity": boxes.velocity_mps[row],
            "attribute": boxes.attribute[row],
            "score": float(boxes.score[row]),
        }
        for row in range(len(boxes))
    ]


def length(vector: Float64) -> float:
    return float(np.linalg.norm(vector))


def heading_error(first: float, second: float, period: float) -> float:
    difference = (first - second + period / 2) % period - period / 2
    return abs(difference - 2 * math.pi if difference > math.pi else difference)


def laid_on_each_other(first: Float64, second: Float64) -> float:
    shared = float(np.prod([min(a, b) for a, b in zip(first, second)]))
    return shared / (float(np.prod(first)) + float(np.prod(second)) - shared)


def mean_so_far(values: list[float]) -> list[float]:
    if all(math.isnan(value) for value in values):
        return [1.0] * len(values)
    means, total, count = [], 0.0, 0
    for value in values:
        if not math.isnan(value):
            total, count = total + value, count + 1
        means.append(total / count if count else 0.0)
    return means


def curve(truth: list[Row], predictions: list[Row], category: str, threshold: float, half_turn: bool) -> dict[str, Any]:
    """Precision, confidence and errors at 101 recalls."""
    names = ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err")
    nothing = {"precision": np.zeros(101), "confidence": np.zeros(101), **{name: np.ones(101) for name in names}}
    by_sample: dict[Any, list[Row]] = {}
    for box in truth:
        if box["category"] == category:
            by_sample.setdefault(box["sample"], []).append(box)
    positives = sum(map(len, by_sample.values()))
    candidates = [box for box in predictions if box["category"] == category]
    # Falling scores; of equal ones the last first.
    candidates = sorted(candidates, key=lambda box: box["score"])[::-1]
    hits: list[int] = []
    matches: list[tuple[float, ...]] = []
    used: set[int] = set()
    for found in candidates:
        nearest, chosen = math.inf, None
        for box in by_sample.get(found["sample"], []):
            distance = length(found["centre"] - box["centre"])
            if id(box) not in used and distance < nearest:
                nearest, chosen = distance, box
        hits.append(int(nearest < threshold))
        if chosen is not None and nearest < threshold:
            used.add(id(chosen))
            matches.append(
                (
                    found["score"],
                    length(found["centre"] - chosen["centre"]),
                    1 - laid_on_each_other(chosen["size"], found["size"]),
                    heading_error(chosen["yaw"], found["yaw"], math.pi if half_turn else 2 * math.pi),
                    length(found["velocity"] - chosen["velocity"]),
                    math.nan if chosen["attribute"] == "" else 1.0 - (chosen["attribute"] == found["attribute"]),
                )
            )
    if positives == 0 or not matches:
        return nothing
    precision, recall, total = [], [], 0
    for rank, hit in enumerate(hits, start=1):
        total += hit
        precision.append(total / rank)
        recall.append(total / positives)
    steps = np.linspace(0, 1, 101)
    scores = [box["score"] for box in candidates]
    result = {
        "precision": np.interp(steps, recall, precision, right=0),
        "confidence": np.interp(steps, recall, scores, right=0),
    }
    columns = list(zip(*matches))
    for name, values in zip(names, columns[1:]):
        means = np.array(mean_so_far(list(values)))
        result[name] = np.interp(result["confidence"][::-1], columns[0][::-1], means[::-1])[::-1]
    return result


def evaluate(truth: DetectionBoxes, predictions: DetectionBoxes, config: DetectionConfig) -> dict[str, Any]:
    true_rows, found_rows = rows(truth), rows(predictions)
    names = ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err")
    curves: dict[tuple[str, float], dict[str, Any]] = {}
    aps: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    first = round(100 * config.min_recall) + 1
    for category in config.class_range:
        aps[category], errors[category] = [], []
        for threshold in config.dist_ths:
            one = curve(true_rows, found_rows, category, threshold, category in config.half_turn_classes)
            curves[category, threshold] = one
            above = [max(value - config.min_precision, 0.0) for value in one["precision"][first:]]
            aps[category].append(float(np.mean(above)) / (1.0 - config.min_precision))
        one = curves[category, config.dist_th_tp]
        reached = max((step for step in range(101) if one["confidence"][step] != 0), default=0)
        for name in names:
            error = float(np.mean(one[name][first : reached + 1])) if reached >= first else 1.0
            errors[category].append(math.nan if name in config.undefined_errors.get(category, ()) else error)
    mean_ap = float(np.mean([np.mean(values) for values in aps.values()]))
    tp_errors = {name: float(np.nanmean([errors[c][column] for c in errors])) for column, name in enumerate(names)}
    scores = [max(0.0, 1.0 - error) for error in tp_errors.values()]
    nds = float(config.mean_ap_weight * mean_ap + np.sum(scores)) / float(config.mean_ap_weight + len(scores))
    return {
        "curves": curves,
        "aps": np.array(list(aps.values())),
        "errors": np.array(list(errors.values())),
        "mean_ap": mean_ap,
        "tp_errors": tp_errors,
        "nds": nds,
    }
