"""Rules of DEP, PTS: depth maps; points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.layer_files import changed_files, missing_files, rows_without_image
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView


@scene_rule(
    "DEP001",
    Severity.ERROR,
    title="A depth map's file is missing, or has another size than its row says.",
    cost=Cost.FILES,
    remedy="write the depth layer again",
)
def _depth_file(view: SceneView) -> Iterator[Finding]:
    yield from missing_files(view, view.depth)


@scene_rule(
    "DEP002",
    Severity.ERROR,
    title="A depth map is of an image that was never recorded.",
    remedy="write the depth layer again, with the stamps of the images table",
)
def _depth_image(view: SceneView) -> Iterator[Finding]:
    yield from rows_without_image(view, view.depth)


@scene_rule(
    "DEP003",
    Severity.ERROR,
    title="A depth map's file has other bytes than were written: another SHA-256.",
    cost=Cost.IMAGES,
    remedy="write the depth layer again",
)
def _depth_hash(view: SceneView) -> Iterator[Finding]:
    yield from changed_files(view, view.depth)


@scene_rule(
    "DEP004",
    Severity.ERROR,
    title=("A depth map has no raster, or no pinhole: a focal length is not positive, or a number not finite."),
    remedy="write the depth layer again, with the raster and lens of its maps",
)
def _depth_lens(view: SceneView) -> Iterator[Finding]:
    rows = view.depth
    lens = np.stack([rows.floats(name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")], axis=1)
    bad = ~np.isfinite(lens).all(axis=1) | ~(lens[:, :2] > 0.0).all(axis=1)
    bad |= (rows.integers("width_px") <= 0) | (rows.integers("height_px") <= 0)
    yield from rows.findings(
        bad,
        lambda row: (
            f"{rows.integers('width_px')[row]} x {rows.integers('height_px')[row]} px, lens {lens[row].tolist()}"
        ),
    )


@scene_rule(
    "PTS001",
    Severity.ERROR,
    title=("A point has a coordinate that is not finite, a negative number of views, or a sigma that is not positive."),
    remedy="write the layer of points again",
)
def _point_numbers(view: SceneView) -> Iterator[Finding]:
    rows = view.points
    place = np.stack([rows.floats(name) for name in ("x_m", "y_m", "z_m")], axis=1)
    sigma = rows.floats("sigma_m")
    bad = ~np.isfinite(place).all(axis=1) | (rows.integers("views") < 0)
    bad |= rows.is_known("sigma_m") & ~((sigma > 0.0) & np.isfinite(sigma))
    yield from rows.findings(
        bad, lambda row: f"at {place[row].tolist()}, views {rows.integers('views')[row]}, sigma_m {sigma[row]}"
    )
