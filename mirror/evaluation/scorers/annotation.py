"""Scores a submission's 3D boxes against the dataset's by the nuScenes detection metrics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from mirror.evaluation.result import GroupFigure, finite_or_none
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import HiddenUse, Job, ScoredJob, Values
from mirror.evaluation.submission.check import MAX_TABLE_BYTES
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.template import detections_path
from mirror.evaluation.submission.untrusted import UntrustedError, parse_untrusted
from mirror.geometry.poses import Poses
from mirror.metrics.catalogue import find_measure
from mirror.metrics.detection.boxes import DetectionBoxes, in_range
from mirror.metrics.detection.config import DETECTION_CVPR_2019, DetectionConfig
from mirror.metrics.detection.nuscenes import NuScenesDetection, nuscenes_detection
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import Detection
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.documents import Document
from mirror.schema.problems import describe_problem

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e7, le=1e7)]
Positive = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_ERRORS: Final = {"trans_err": "mate_m", "scale_err": "mase", "orient_err": "maoe_rad", "vel_err": "mave_mps"}


class DetectedBox(Document):
    """One detected box, in the ego frame at the time of its frame.

    Attributes:
        category: one of the protocol's classes.
        score: confidence, 0 to 1.
        ego_SE3_box: pose of the box as ``qw qx qy qz tx_m ty_m tz_m``.
        size_m: length, width, height.
        velocity_mps: velocity over ground along the ego's x and y axes; None if unknown.
    """

    category: str
    score: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    ego_SE3_box: tuple[Number, Number, Number, Number, Number, Number, Number]
    size_m: tuple[Positive, Positive, Positive]
    velocity_mps: tuple[Number, Number] | None = None


class DetectedFrame(Document):
    """The boxes of one frame."""

    frame_index: int
    boxes: tuple[DetectedBox, ...]


class SubmittedDetections(Document):
    """``detections/<traversal>.json``: the detections that a submission states for a traversal."""

    format: Literal["mirror-detections"] = "mirror-detections"
    version: Literal["1.0"] = "1.0"
    frames: tuple[DetectedFrame, ...]


class AnnotationScorer:
    """The scorer of the task ``annotation``."""

    version = 1

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return ``unused``: the truth is the dataset's boxes."""
        return "unused"

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return no names: no metric has weights."""
        return {}

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return no metrics: every metric is available."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return one job for each traversal, which validates its table of boxes."""
        return [
            Job(path, tuple(views), (path,), truth=False, in_table=False)
            for path, views in ((detections_path(key), views) for key, views in _views_by_traversal(plan).items())
        ]

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Read a table, and count its boxes."""
        return {"boxes": sum(len(frame.boxes) for frame in _read_detections(job, inputs).values())}

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Compute the figures over the boxes of all frames together."""
        group = plan.protocol.groups[0].name
        metric = _detection_metric(plan.protocol)
        config = _make_config(metric)
        true, predicted = [_no_boxes()], [_no_boxes()]
        for scored_job in scored:
            frames = _read_detections(scored_job.job, inputs)
            for view in scored_job.job.views:
                sample = f"{view.traversal_id} {view.frame_index}"
                true.append(_true_boxes(sample, view, inputs, config))
                predicted.append(_predicted_boxes(sample, frames.get(view.frame_index), config))
        truth, predictions = (
            part[in_range(part, (0.0, 0.0), config)] for part in map(DetectionBoxes.concatenate, (true, predicted))
        )
        detection = nuscenes_detection(truth, predictions, config, absent=metric.absent)
        return list(_make_figures(group, detection, len(truth)))


def _detection_metric(protocol: Protocol) -> Detection:
    return next(metric for metric in protocol.metrics if isinstance(metric, Detection))


def _views_by_traversal(plan: Plan) -> dict[str, list[RenderView]]:
    """Select one view of each frame, grouped by traversal."""
    traversals: dict[str, dict[int, RenderView]] = {}
    for view in plan.views:
        traversals.setdefault(view.traversal_id, {}).setdefault(view.frame_index, view)
    return {key: list(frames.values()) for key, frames in traversals.items()}


def _make_config(metric: Detection) -> DetectionConfig:
    standard = DETECTION_CVPR_2019
    return DetectionConfig(
        class_range=metric.class_range_m,
        dist_ths=standard.dist_ths,
        dist_th_tp=standard.dist_th_tp,
        min_recall=standard.min_recall,
        min_precision=standard.min_precision,
        max_boxes_per_sample=metric.max_boxes_per_frame,
        mean_ap_weight=standard.mean_ap_weight,
        undefined_errors=dict.fromkeys(metric.class_range_m, ("attr_err",)),
    )


def _read_detections(job: Job, inputs: ScoringInputs) -> dict[int, DetectedFrame]:
    """Read a submission's boxes by frame.

    Raises:
        UntrustedError: the table is invalid, repeats a frame, or has a frame that the plan does not request or a class
            that the protocol does not have.
    """
    path = job.reads[0]
    raw = parse_untrusted(inputs.read(path), path, MAX_TABLE_BYTES)
    try:
        frames = SubmittedDetections.model_validate(raw).frames
    except (ValidationError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        place = "" if first is None else ".".join(map(str, first["loc"]))
        problem = "nested too deep" if first is None else describe_problem(first)
        raise UntrustedError(problem, file=path, place=place) from error
    metric = _detection_metric(inputs.protocol)
    requested = {view.frame_index for view in job.views}
    by_index: dict[int, DetectedFrame] = {}
    for frame in frames:
        place = f"frame {frame.frame_index}"
        if frame.frame_index not in requested or frame.frame_index in by_index:
            raise UntrustedError("not requested, or repeated", file=path, place=place)
        if len(frame.boxes) > metric.max_boxes_per_frame:
            raise UntrustedError(
                f"{len(frame.boxes)} boxes", file=path, place=place, expected=f"at most {metric.max_boxes_per_frame}"
            )
        unknown = {box.category for box in frame.boxes} - set(metric.class_range_m)
        if unknown:
            expected = f"one of {', '.join(metric.class_range_m)}"
            raise UntrustedError(f"class {min(unknown)!r:.60}", file=path, place=place, expected=expected)
        if any(not any(box.ego_SE3_box[:4]) for box in frame.boxes):
            raise UntrustedError("a quaternion of length 0", file=path, place=place)
        by_index[frame.frame_index] = frame
    return by_index


def _no_boxes() -> DetectionBoxes:
    return _make_boxes(
        "", (), Poses(np.empty((0, 4)), np.empty((0, 3))), np.empty((0, 3)), np.empty((0, 2)), np.empty(0)
    )


def _make_boxes(
    sample: str, category: Iterable[str], poses: Poses, lwh_m: np.ndarray, velocity: np.ndarray, score: np.ndarray
) -> DetectionBoxes:
    names = np.array(list(category), dtype=object)
    samples = np.full(len(names), sample, dtype=object)
    return DetectionBoxes.from_poses(samples, names, poses, lwh_m, velocity_mps=velocity, score=score)


def _true_boxes(sample: str, view: RenderView, inputs: ScoringInputs, config: DetectionConfig) -> DetectionBoxes:
    frame, _ = inputs.truth.recorded_frame_and_image(view)
    boxes = frame.boxes("ego")
    rows = np.flatnonzero(np.isin(np.array(boxes.category, dtype=object), list(config.class_range)))
    if not len(rows):
        return _no_boxes()
    names = [boxes.category[row] for row in rows]
    velocity = boxes.velocity_mps[rows, :2]
    return _make_boxes(sample, names, boxes.pose[rows], boxes.size_m[rows], velocity, np.zeros(len(rows)))


def _predicted_boxes(sample: str, frame: DetectedFrame | None, config: DetectionConfig) -> DetectionBoxes:
    if frame is None or not frame.boxes:
        return _no_boxes()
    numbers = np.array([box.ego_SE3_box for box in frame.boxes])
    velocity = np.array([box.velocity_mps or (np.nan, np.nan) for box in frame.boxes])
    sizes, scores = np.array([box.size_m for box in frame.boxes]), np.array([box.score for box in frame.boxes])
    names = [box.category for box in frame.boxes]
    return _make_boxes(sample, names, Poses(numbers[:, :4], numbers[:, 4:]), sizes, velocity, scores)


def _make_figures(group: str, detection: NuScenesDetection, count: int) -> Iterable[GroupFigure]:
    def figure(metric: str, value: float, reason: str | None) -> GroupFigure:
        measure = find_measure(metric)
        return GroupFigure(
            metric=metric,
            group=group,
            value=finite_or_none(value),
            reason=reason,
            unit=measure.unit,
            better=measure.better,
            n=count,
            interval_reason="a single figure of all boxes",
        )

    errors = {name: detection.tp_errors[name] for name in _ERRORS}
    yield figure("mean_ap", detection.mean_ap, detection.mean_ap.reason)
    for name, metric in _ERRORS.items():
        yield figure(metric, errors[name], errors[name].reason)
    reasons = [score.reason for score in (detection.mean_ap, *errors.values()) if score.reason is not None]
    weight = detection.config.mean_ap_weight
    total = weight * detection.mean_ap + sum(max(0.0, 1.0 - error) for error in errors.values())
    yield figure("nds_no_attr", total / (weight + len(errors)), reasons[0] if reasons else None)
    for name, row in zip(detection.config.class_range, detection.label_aps):
        if name not in detection.absent_classes:
            yield figure(f"ap_{name}", float(np.mean(row)), None)


SCORER: Final = AnnotationScorer()
