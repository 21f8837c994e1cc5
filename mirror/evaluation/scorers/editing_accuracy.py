"""Whether an edited vehicle is where it was asked to be: its region against its projected target box."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.evaluation.extractors import Extractor, make_extractor
from mirror.evaluation.figures import Measure, compute_figures
from mirror.evaluation.result import Figure
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.reconstruction import find_score
from mirror.evaluation.scorers.scorer import Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.geometry.box_projection import project_boxes
from mirror.metrics.boxes.iou_2d import HullVariant, hull_iou
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import EditIou, Protocol, metric_name
from mirror.protocols.views.plan import Plan, render_path
from mirror.protocols.views.view import Edit, RenderView, to_pose

ALL: Final = "all"
_VARIANTS: Final[Mapping[str, HullVariant]] = {
    "hull": "mask_hull",
    "box": "box_box",
    "ceiling": "ceiling_normalised",
}


class EditingAccuracy:
    """See the module."""

    version = 1

    def needs_hidden(self, plan: Plan) -> bool:
        """Not here."""
        return False

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """No weights of the table: an extractor has its own."""
        return {}

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Nothing else is needed."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """One an edited view; its background is read too."""
        make_extractor(inputs.extractor)
        background = _background(plan.protocol)
        views = {view.path: view for view in plan.views}
        found = []
        for view in plan.views:
            if view.group != background:
                path = render_path(background, view.traversal_id, view.camera, view.timestamp_ns)
                found.append(Job(view.path, (view, views[path]), (view.path, path), truth=False))
        return found

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """All variants of one view."""
        view, background = job.views
        edit = view.edits[0]
        counted = inputs.scored_mask(view) & ~_nearer(view, edit, inputs)
        region = _extractor(inputs).extract(inputs.render(view), inputs.render(background), counted, view.path)
        hull = target_hull(view, edit)
        shown = int((polygon_mask(hull, view.width_px, view.height_px) & counted).sum())
        values: dict[str, float | int | str | None] = {
            "track_id": edit.track_id,
            "region_px": int(region.sum()),
            "target_px": shown,
        }
        vehicles = inputs.protocol.vehicles
        least = 1.0 if vehicles is None else vehicles.min_area_px
        for metric in inputs.protocol.metrics:
            if isinstance(metric, EditIou):
                name = metric_name(metric)
                found = hull_iou(region, hull, variant=_VARIANTS[metric.variant], valid=counted)
                values[name] = float(found) if shown >= least else math.nan
                reason = found.reason if shown >= least else f"the target shows fewer than {least:g} counted pixels"
                if reason is not None:
                    values[f"{name}.reason"] = reason
        return values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[Figure]:
        """Means of each shift, and of all together."""
        found: list[Figure] = []
        names = [group.name for group in plan.protocol.groups if group.name != _background(plan.protocol)]
        for group in (*names, ALL):
            own = [one for one in scored if group in (ALL, one.job.views[0].group)]
            views = [one.job.views[0] for one in own]
            for metric in plan.protocol.metrics:
                name = metric_name(metric)
                scores = [find_score(one.values, name) for one in own]
                found += compute_figures(plan.protocol, Measure(name, "", "higher"), group, views, scores)
        return found


def _background(protocol: Protocol) -> str:
    return next(group.name for group in protocol.groups if group.without_vehicles)


def _extractor(inputs: ScoringInputs) -> Extractor:
    if "extractor" not in inputs.made:
        inputs.made["extractor"] = make_extractor(inputs.extractor)
    found: Extractor = inputs.made["extractor"]  # type: ignore[assignment]
    return found


def target_hull(view: RenderView, edit: Edit) -> Float64:
    """The convex outline (K, 2) of the target box."""
    if edit.world_SE3_target is None:
        return np.empty((0, 2))
    return project_boxes(view.lens, view.pose.inverse() @ to_pose(edit.world_SE3_target), [edit.size_m]).hull(0)


def _nearer(view: RenderView, edit: Edit, inputs: ScoringInputs) -> Bool:
    """Pixels (H, W) within hulls of other boxes that are nearer to the camera than the target: they may hide it."""
    lens = view.lens
    hidden = np.zeros((lens.height_px, lens.width_px), np.bool_)
    frame, _ = inputs.truth.recorded_frame_and_image(view)
    boxes = frame.boxes("world")
    if edit.world_SE3_target is None or not len(boxes):
        return hidden
    camera_SE3_world = view.pose.inverse()
    reach = np.linalg.norm((camera_SE3_world @ to_pose(edit.world_SE3_target)).translation[0])
    poses = camera_SE3_world @ boxes.pose
    projected = project_boxes(lens, poses, boxes.size_m)
    nearer = np.linalg.norm(poses.translation, axis=1) < reach
    for row in np.flatnonzero(projected.visible & nearer).tolist():
        if boxes.track_id[row] != edit.track_id:
            hidden |= polygon_mask(projected.hull(row), lens.width_px, lens.height_px)
    return hidden


SCORER: Final = EditingAccuracy()
