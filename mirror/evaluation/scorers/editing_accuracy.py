"""Scores edited vehicles: overlap of the edited image region with the projected target box."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mirror.arrays import Bool
from mirror.evaluation.extractors import ObjectExtractor, make_extractor
from mirror.evaluation.figures import compute_figures, compute_overall_figure
from mirror.evaluation.result import GroupFigure
from mirror.evaluation.scorers.edit_fidelity import fidelity_figures, has_fidelity, score_fidelity
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.reconstruction import find_score
from mirror.evaluation.scorers.scorer import HiddenUse, Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.geometry.box_projection import project_boxes
from mirror.metrics.boxes.iou_2d import HullVariant, hull_iou
from mirror.metrics.boxes.raster import polygon_mask
from mirror.metrics.catalogue import MEASURES
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import EditIou, metric_name
from mirror.protocols.views.edited_region import target_hull
from mirror.protocols.views.plan import Plan, render_path
from mirror.protocols.views.view import Edit, RenderView

_VARIANTS: Final[Mapping[str, HullVariant]] = {
    "hull": "mask_hull",
    "box": "box_box",
    "ceiling": "ceiling_normalised",
}


class EditingScorer:
    """The scorer of the task ``editing-accuracy``."""

    version = 3

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return ``optional``: overlaps need the plan's target boxes alone, other figures the exact truth."""
        return "optional"

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return no names: the metrics need no weights; an extractor loads its own weights."""
        return {}

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return no metrics: every metric is available."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return one job for each edited view, which also reads the render without vehicles."""
        extractor = make_extractor(inputs.extractor)
        background = _background_group(plan.protocol)
        views = {view.path: view for view in plan.views}
        jobs = []
        for view in plan.views:
            if view.group != background:
                path = render_path(background, view.traversal_id, view.camera, view.timestamp_ns)
                files = (view.path, path)
                fingerprint, scores_truth = extractor.fingerprint(view.path), has_fidelity(view, inputs)
                jobs.append(Job(view.path, (view, views[path]), files, truth=scores_truth, fingerprint=fingerprint))
        return jobs

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Compute the figures of one view: all variants of the IoU, and the figures against the exact truth."""
        view, background = job.views
        edit = view.edits[0]
        scored = inputs.scored_mask(view) & ~_occluder_mask(view, edit, inputs)
        render = inputs.render(view)
        region = _get_extractor(inputs).extract(render, inputs.render(background), scored, view.path)
        hull = target_hull(view, edit)
        target_px = int((polygon_mask(hull, view.width_px, view.height_px) & scored).sum())
        values: dict[str, float | int | str | None] = {
            "track_id": edit.track_id,
            "region_px": int(region.sum()),
            "target_px": target_px,
        }
        vehicles = inputs.protocol.vehicles
        min_area_px = 1.0 if vehicles is None else vehicles.min_area_px
        for metric in inputs.protocol.metrics:
            if isinstance(metric, EditIou):
                name = metric_name(metric)
                iou = hull_iou(region, hull, variant=_VARIANTS[metric.variant], valid=scored)
                value, reason = float(iou), iou.reason
                if target_px < min_area_px:
                    value, reason = math.nan, f"the target has fewer than {min_area_px:g} scored pixels"
                values[name] = value
                if reason is not None:
                    values[f"{name}.reason"] = reason
        return {**values, **score_fidelity(view, render, inputs)} if has_fidelity(view, inputs) else values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Return the means of each group of shifted vehicles, and the means over the groups that rank."""
        figures: list[GroupFigure] = []
        background = _background_group(plan.protocol)
        names = [group.name for group in plan.protocol.groups if group.name != background]
        for group in names:
            members = [scored_job for scored_job in scored if group == scored_job.job.views[0].group]
            views = [scored_job.job.views[0] for scored_job in members]
            for metric in plan.protocol.metrics:
                if isinstance(metric, EditIou):
                    name = metric_name(metric)
                    scores = [find_score(scored_job.values, name) for scored_job in members]
                    figures += compute_figures(plan.protocol, MEASURES[name], group, views, scores)
        views = [scored_job.job.views[0] for scored_job in scored]
        for metric in plan.protocol.metrics:
            if isinstance(metric, EditIou):
                name = metric_name(metric)
                scores = [find_score(scored_job.values, name) for scored_job in scored]
                figures += compute_overall_figure(plan.protocol, MEASURES[name], views, scores)
        return [*fidelity_figures(plan.protocol, scored, inputs), *figures]


def _background_group(protocol: Protocol) -> str:
    return next(group.name for group in protocol.groups if group.without_vehicles)


def _get_extractor(inputs: ScoringInputs) -> ObjectExtractor:
    if "extractor" not in inputs.made:
        inputs.made["extractor"] = make_extractor(inputs.extractor)
    extractor: ObjectExtractor = inputs.made["extractor"]  # type: ignore[assignment]
    return extractor


def _occluder_mask(view: RenderView, edit: Edit, inputs: ScoringInputs) -> Bool:
    """Return the mask (H, W) of the hulls of other boxes that are nearer to the camera than the target."""
    lens = view.lens
    hidden = np.zeros((lens.height_px, lens.width_px), np.bool_)
    frame, _ = inputs.truth.recorded_frame_and_image(view)
    boxes = frame.boxes("world")
    if edit.world_SE3_target is None or not len(boxes):
        return hidden
    camera_SE3_world = view.pose.inverse()
    target_distance_m = np.linalg.norm((camera_SE3_world @ edit.world_SE3_target).translation[0])
    poses = camera_SE3_world @ boxes.pose
    projected = project_boxes(lens, poses, boxes.size_m)
    nearer = np.linalg.norm(poses.translation, axis=1) < target_distance_m
    for row in np.flatnonzero(projected.visible & nearer).tolist():
        if boxes.track_id[row] != edit.track_id:
            hidden |= polygon_mask(projected.hull(row), lens.width_px, lens.height_px)
    return hidden


SCORER: Final = EditingScorer()
