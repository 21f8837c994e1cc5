"""Edits without a model of the street: each view is made from the recorded image of its camera and instant.

Three of them are floors, which show no edit. The fourth is the simplest honest edit, and has no floor's excuse: it
cuts each vehicle out of the recorded image and shows it at its target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
from mirror.evaluation.submission.writing import Render
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Edit, Plan, RenderView
from mirror.protocols.views.edited_region import grow_hull, recorded_hull, target_hull

Change = Callable[[RenderView, UInt8], UInt8]
"""Makes a render (H, W, 3) from a view and its recorded image."""

APPEARANCE: Final = Appearance(policy="none", description="that of the recorded image of the same instant")

_MARGIN_PX: Final = 2
_SHARE_OF_HULL: Final = 0.3
_ITERATIONS: Final = 4
_INPAINTED_PX: Final = 4.0


@dataclass(frozen=True)
class EditedRecording:
    """One way to make a view from its recorded image.

    Attributes:
        method: entry of the manifest.
        change: makes a render.
    """

    method: SubmittedMethod
    change: Change

    def render(self, dataset: Dataset, plan: Plan) -> Iterator[Render]:
        """Render each view; see `mirror.evaluation.submission.writing.Renderer`.

        Raises:
            UsageError: the protocol edits no vehicles.
        """
        if plan.protocol.vehicles is None:
            raise UsageError(
                f"protocol {plan.protocol.name} edits no vehicles", place="--protocol", expected="one that does"
            )
        truth = GroundTruth(dataset, plan.protocol, plan.layers)
        for view in plan.views:
            yield (view,), self.change(view, truth.image(view))


def keep(view: RenderView, recorded: UInt8) -> UInt8:
    """Return the recorded image."""
    return recorded


def erase(view: RenderView, recorded: UInt8) -> UInt8:
    """Replace the edited vehicles by an inpainting of their surroundings (Telea's)."""
    mask = np.zeros(recorded.shape[:2], np.bool_)
    for edit in view.edits:
        mask |= _outline(view, edit, recorded)
    hole = np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=_MARGIN_PX), np.uint8)
    if not hole.any() or hole.all():
        return recorded
    return np.asarray(cv2.inpaint(recorded, hole, _INPAINTED_PX, cv2.INPAINT_TELEA), np.uint8)


def paint(view: RenderView, recorded: UInt8) -> UInt8:
    """Erase the edited vehicles, and fill the hull of each target with the vehicle's mean colour."""
    painted = erase(view, recorded).copy()
    for edit in _from_far_to_near(view):
        old = _mask(view, recorded_hull(view, edit))
        if old.any():
            painted[_mask(view, target_hull(view, edit))] = np.round(recorded[old].mean(axis=0))
    return painted


def move(view: RenderView, recorded: UInt8) -> UInt8:
    """Erase the edited vehicles, and show each vehicle at its target as a flat cutout that faces the camera."""
    moved = erase(view, recorded).copy()
    lens, camera_SE3_world = view.lens, view.pose.inverse()
    for edit in _from_far_to_near(view):
        if edit.world_SE3_target is None:
            continue
        part, target = _crop(_mask(view, target_hull(view, edit)))
        if not target.size:
            continue
        old, new = ((camera_SE3_world @ pose).translation[0] for pose in (edit.world_SE3_box, edit.world_SE3_target))
        v, u = np.mgrid[part].astype(np.float64) + 0.5
        rays = lens.unproject(np.stack([u, v], axis=-1)).direction
        # The plane through the middle of the target, perpendicular to the line of sight.
        ahead = rays @ new
        points = rays * (new @ new / np.where(ahead > 1e-6, ahead, np.nan))[..., None] - new + old
        seen = lens.project(points)
        places = np.where(seen.valid[..., None], seen.uv_px, -9.0).astype(np.float32) - np.float32(0.5)
        maps = np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
        cut = _outline(view, edit, recorded).astype(np.uint8)
        is_shown = target & (cv2.remap(cut, *maps, cv2.INTER_NEAREST) > 0)
        moved[part][is_shown] = cv2.remap(recorded, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[is_shown]
    return moved


def _mask(view: RenderView, hull: np.ndarray) -> Bool:
    return polygon_mask(hull, view.width_px, view.height_px)


def _outline(view: RenderView, edit: Edit, recorded: UInt8) -> Bool:
    """Find the vehicle's pixels within the hull of its box (GrabCut); the whole hull if little of it is found."""
    hull = _mask(view, recorded_hull(view, edit))
    around = _mask(view, grow_hull(recorded_hull(view, edit), 0.5))
    if not hull.any() or not (around & ~hull).any():
        return hull
    part, _ = _crop(around)
    labels = np.where(hull, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)[part]
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(recorded[part]), labels, (0, 0, 0, 0), *models, _ITERATIONS, cv2.GC_INIT_WITH_MASK)
    found = np.zeros_like(hull)
    found[part] = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return found if found.sum() >= _SHARE_OF_HULL * hull.sum() else hull


def _crop(mask: Bool) -> tuple[tuple[slice, slice], Bool]:
    """Return the part of the image that bounds a mask, and the mask there."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return (slice(0, 0), slice(0, 0)), mask[:0, :0]
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return part, mask[part]


def _from_far_to_near(view: RenderView) -> list[Edit]:
    camera_SE3_world = view.pose.inverse()

    def distance_m(edit: Edit) -> float:
        return float(np.linalg.norm((camera_SE3_world @ edit.world_SE3_box).translation[0]))

    return sorted((edit for edit in view.edits if edit.world_SE3_target is not None), key=distance_m, reverse=True)


def _describe(name: str, change: Change) -> EditedRecording:
    trained_on = "nothing: the recorded image of each view is shown or changed"
    return EditedRecording(SubmittedMethod(name=name, version="1", licence="Apache-2.0", trained_on=trained_on), change)


EDITED_RECORDINGS: Final[Mapping[str, EditedRecording]] = {
    name: _describe(name, change)
    for name, change in {
        "unmoved_recording": keep,
        "erased_vehicle": erase,
        "flat_patch": paint,
        "moved_cutout": move,
    }.items()
}
"""Methods by name; all but ``moved_cutout`` are floors."""
