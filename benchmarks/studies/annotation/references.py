"""What is printed beside the network: boxes without images, and the ground under exact two-dimensional boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.studies.annotation.scoring import Found, TestFrame
from hybridworldsim.petr.tiny.network import STRIDE
from hybridworldsim.petr.tiny.samples import Sample
from hybridworldsim.petr.tiny.settings import CLASSES
from mirror.arrays import Float64

_CELL_M: Final = 2.0
_MOST: Final = 100
_TURNS: Final = 8


def prior_boxes(samples: Sequence[Sample], range_m: float) -> Found:
    """Return the most frequent places of cars around the vehicle in the training frames, for every frame.

    The score of a place is the share of the frames with a car in its cell of 2 m; its heading and size are the most
    frequent and the median ones there.
    """
    car = CLASSES.index("car")
    chosen = [(one.boxes, one.boxes.label == car) for one in samples]
    centre = np.concatenate([boxes.centre_m[rows] for boxes, rows in chosen]).astype(np.float64)
    size = np.concatenate([boxes.size_m[rows] for boxes, rows in chosen]).astype(np.float64)
    yaw = np.concatenate([boxes.yaw_rad[rows] for boxes, rows in chosen]).astype(np.float64)
    near = np.hypot(centre[:, 0], centre[:, 1]) <= range_m
    centre, size, yaw = centre[near], size[near], yaw[near]
    _, which, counts = np.unique(np.floor(centre[:, :2] / _CELL_M), axis=0, return_inverse=True, return_counts=True)
    best = np.argsort(-counts, kind="stable")[:_MOST]
    places, sizes, yaws = [], [], []
    for cell in best.tolist():
        rows = np.flatnonzero(which.ravel() == cell)
        places.append(centre[rows].mean(axis=0))
        sizes.append(np.median(size[rows], axis=0))
        turns = np.round(yaw[rows] / (2.0 * np.pi / _TURNS)).astype(int) % _TURNS
        yaws.append(np.bincount(turns, minlength=_TURNS).argmax() * 2.0 * np.pi / _TURNS)
    return Found(np.array(places), np.array(sizes), np.array(yaws), counts[best] / len(samples))


def ground_boxes(usual: Found) -> Callable[[TestFrame], Found]:
    """Return the boxes where the rays through the lower edges of exact two-dimensional boxes meet the ground z = 0.

    Half a width of a usual car is added along the ray; size and heading are the usual ones. All scores are 1, so the
    nearer boxes go first.
    """
    usual_size = np.median(usual.size_m, axis=0)

    def find(frame: TestFrame) -> Found:
        centres, scores = [], []
        for bounds, image in zip(frame.bounds_px, frame.image):
            u, v = 0.5 * (bounds[0] + bounds[2]), bounds[3]
            ray = _ray(frame, image, u, v)
            origin = frame.cameras.origins[image].astype(np.float64)
            if ray[2] > -0.01:
                continue
            away = -origin[2] / ray[2]
            level = ray[:2] / max(float(np.hypot(*ray[:2])), 1e-6)
            place = origin[:2] + away * ray[:2] + 0.5 * usual_size[1] * level
            centres.append((*place, 0.5 * usual_size[2]))
            scores.append(1.0 / (1.0 + np.hypot(*place)))
        count = len(centres)
        return Found(
            np.array(centres).reshape(-1, 3), np.tile(usual_size, (count, 1)), np.zeros(count), np.array(scores)
        )

    return find


def _ray(frame: TestFrame, image: int, u: float, v: float) -> Float64:
    """The ray through a pixel of the network's raster, between those of the tokens around it."""
    rays = frame.cameras.directions[image].astype(np.float64)
    row = min(max(v / STRIDE - 0.5, 0.0), rays.shape[0] - 1.001)
    column = min(max(u / STRIDE - 0.5, 0.0), rays.shape[1] - 1.001)
    top, left = int(row), int(column)
    down, right = v / STRIDE - 0.5 - top, u / STRIDE - 0.5 - left
    upper = rays[top, left] * (1.0 - right) + rays[top, left + 1] * right
    lower = rays[top + 1, left] * (1.0 - right) + rays[top + 1, left + 1] * right
    ray: Float64 = upper * (1.0 - down) + lower * down
    return ray / float(np.linalg.norm(ray))
