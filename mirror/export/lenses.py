"""Camera models of other formats: the same projection exactly, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

from mirror.errors import UsageError
from mirror.export.scene import ExportImage
from mirror.geometry.cameras import Camera


class ForeignLens(NamedTuple):
    """A camera in the terms of another format.

    Attributes:
        model: name of the model.
        coefficients: distortion, by name.
    """

    model: str
    coefficients: Mapping[str, float]


LensMap = Callable[[Camera], ForeignLens | None]
"""Maps a camera to a format's model; None: the format has no model with this projection."""


def colmap_lens(camera: Camera) -> ForeignLens | None:
    """Return the COLMAP 4 model with the projection of a camera, in MIRROR's pixel coordinates.

    Source: https://github.com/colmap/colmap/blob/main/src/colmap/sensor/models.h
    """
    if camera.model == "pinhole":
        return ForeignLens("PINHOLE", {})
    if camera.model == "brown_conrady" and camera.distortion[4] == 0.0:
        return ForeignLens("OPENCV", dict(zip(("k1", "k2", "p1", "p2"), camera.distortion)))
    if camera.model in ("brown_conrady", "rational"):
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        values = (*camera.distortion, 0.0, 0.0, 0.0)
        return ForeignLens("FULL_OPENCV", dict(zip(names, values)))
    if camera.model == "kannala_brandt":
        return ForeignLens("OPENCV_FISHEYE", dict(zip(("k1", "k2", "k3", "k4"), camera.distortion)))
    return None


def gsplat_lens(camera: Camera) -> ForeignLens | None:
    """Return a COLMAP model that gsplat's ``Parser`` reads; None for sixth-order radial or rational terms.

    Source: https://github.com/nerfstudio-project/gsplat/blob/main/examples/datasets/colmap.py
    """
    lens = colmap_lens(camera)
    return None if lens is None or lens.model == "FULL_OPENCV" else lens


def nerfstudio_lens(camera: Camera) -> ForeignLens | None:
    """Return the nerfstudio model with the projection of a camera; its radial polynomial has four terms.

    Source: ``nerfstudio/cameras/camera_utils.py`` (radial_and_tangential_undistort, fisheye_undistort).
    """
    if camera.model == "pinhole":
        return ForeignLens("OPENCV", {})
    if camera.model == "brown_conrady" or (camera.model == "rational" and not any(camera.distortion[5:])):
        k1, k2, p1, p2, k3 = camera.distortion[:5]
        return ForeignLens("OPENCV", {"k1": k1, "k2": k2, "k3": k3, "k4": 0.0, "p1": p1, "p2": p2})
    if camera.model == "kannala_brandt":
        return ForeignLens("OPENCV_FISHEYE", dict(zip(("k1", "k2", "k3", "k4"), camera.distortion)))
    return None


def pinhole_lens(camera: Camera) -> ForeignLens | None:
    """Return the pinhole lens for formats with a 3x3 matrix; None for distorted cameras."""
    return ForeignLens("pinhole", {}) if camera.lens.straight and camera.model != "kannala_brandt" else None


_REMEDY: Final = "give --undistort: images of such cameras are then resampled to pinhole cameras"


def require_lenses(layout: str, images: Iterable[ExportImage], lens_of: LensMap) -> None:
    """Check that a format can hold every camera, before anything is written.

    Raises:
        UsageError: it has no model with the projection of a camera; the camera and its model are named.
    """
    seen: set[Camera] = set()
    for item in images:
        camera = item.lens
        if camera in seen:
            continue
        seen.add(camera)
        if lens_of(camera) is None:
            raise UsageError(
                f"{layout} has no camera model with the projection of {camera.model}"
                f" {list(camera.distortion)}",
                place=f"camera {item.image.camera}, traversal {item.frame.traversal_id}",
                expected="a camera model that the format has", remedy=_REMEDY,
            )  # fmt: skip
