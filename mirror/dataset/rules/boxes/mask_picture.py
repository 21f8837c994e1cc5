"""MSK002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("MSK002", Severity.ERROR, remedy="write the mask layer again, with the stamps of the images table")
def mask_picture(view: SceneView) -> Iterator[Finding]:
    """A mask is of a picture that was never recorded."""
    masks, images = view.masks, view.images
    codes, names = images.words("camera")
    code_of = {name: code for code, name in enumerate(names)}
    mask_codes, mask_names = masks.words("camera")
    camera = np.array([code_of.get(name, -1) for name in mask_names], np.int64)[mask_codes]
    stamps, taken = masks.integers("timestamp_ns"), images.integers("timestamp_ns")
    pictures = {number: rows for _, number, rows in images.slices()}
    lost = np.zeros(len(masks), np.bool_)
    for _, number, rows in masks.slices():
        own = pictures.get(number, slice(0, 0))
        known = set(zip(codes[own].tolist(), taken[own].tolist()))
        lost[rows] = [key not in known for key in zip(camera[rows].tolist(), stamps[rows].tolist())]
    yield from masks.findings(lost, lambda row: "no picture of this camera and instant")
