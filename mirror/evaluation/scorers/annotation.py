"""3D boxes against the dataset's, as nuScenes scores detection."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from mirror.evaluation.result import Figure, finite_or_none
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import Job, ScoredJob, Values
from mirror.evaluation.submission.check import MAX_TABLE_BYTES
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.template import detections_path
from mirror.evaluation.submission.untrusted import UntrustedError, parse_untrusted
from mirror.geometry.poses import Poses
from mirror.metrics.detection.boxes import DetectionBoxes, in_range
from mirror.metrics.detection.config import DETECTION_CVPR_2019, DetectionConfig
from mirror.metrics.detection.nuscenes import NuScenesDetection, nuscenes_detection
from mirror.protocols.document import Detection
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.documents import Document

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e7, le=1e7)]
Positive = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_ERRORS: Final = {
    "trans_err": ("mate_m", "m"),
    "scale_err": ("mase", ""),
    "orient_err": ("maoe_rad", "rad"),
    "vel_err": ("mave_mps", "m/s"),
}


class DetectedBox(Document):
    """One box, in the ego frame at the frame's instant.

    Attributes:
        category: one of the protocol's classes.
        score: confidence.
        ego_SE3_box: pose, as ``qw qx qy qz tx_m ty_m tz_m``.
        size_m: length, width, height.
        velocity_mps: over ground, along the ego's x and y; None: not known.
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


class Detections(Document):
    """``detections/<traversal>.json``."""

    format: Literal["mirror-detections"] = "mirror-detections"
    version: Literal["1.0"] = "1.0"
    frames: tuple[DetectedFrame, ...]


class Annotation:
    """See the module."""

    version = 1

    def needs_hidden(self, plan: Plan) -> bool:
        """Not here."""
        return False

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """No weights."""
        return {}

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Nothing else is needed."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """One a traversal: its table is held against the format."""
        return [
            Job(path, tuple(views), (path,), truth=False, in_table=False)
            for path, views in ((detections_path(key), views) for key, views in _frames(plan).items())
        ]

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Read a table; how many boxes it has."""
        return {"boxes": sum(len(frame.boxes) for frame in _read(job, inputs).values())}

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[Figure]:
        """Match all frames together."""
        group = plan.protocol.groups[0].name
        metric = next(one for one in plan.protocol.metrics if isinstance(one, Detection))
        config = _config(metric)
        true, predicted = [_none()], [_none()]
        for one in scored:
            found = _read(one.job, inputs)
            for view in one.job.views:
                sample = f"{view.traversal_id} {view.frame_index}"
                true.append(_truth(sample, view, inputs, config))
                predicted.append(_predicted(sample, found.get(view.frame_index), config))
        truth, predictions = (
            part[in_range(part, (0.0, 0.0), config)] for part in map(DetectionBoxes.concatenate, (true, predicted))
        )
        return list(_figures(group, nuscenes_detection(truth, predictions, config, absent=metric.absent), len(truth)))


def _frames(plan: Plan) -> dict[str, list[RenderView]]:
    """One view a frame, by traversal."""
    found: dict[str, dict[int, RenderView]] = {}
    for view in plan.views:
        found.setdefault(view.traversal_id, {}).setdefault(view.frame_index, view)
    return {key: list(frames.values()) for key, frames in found.items()}


def _config(metric: Detection) -> DetectionConfig:
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


def _read(job: Job, inputs: ScoringInputs) -> dict[int, DetectedFrame]:
    """A submission's boxes by frame.

    Raises:
        UntrustedError: not of the format, a frame twice or not asked for, a class that the protocol does not have.
    """
    path = job.reads[0]
    raw = parse_untrusted(inputs.files.read(path, MAX_TABLE_BYTES), path, MAX_TABLE_BYTES)
    try:
        frames = Detections.model_validate(raw).frames
    except (ValidationError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        place = "" if first is None else ".".join(map(str, first["loc"]))
        raise UntrustedError("nested too deep" if first is None else first["msg"], file=path, place=place) from error
    metric = next(one for one in inputs.protocol.metrics if isinstance(one, Detection))
    asked = {view.frame_index for view in job.views}
    found: dict[int, DetectedFrame] = {}
    for frame in frames:
        place = f"frame {frame.frame_index}"
        if frame.frame_index not in asked or frame.frame_index in found:
            raise UntrustedError("not asked for, or twice", file=path, place=place)
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
        found[frame.frame_index] = frame
    return found


def _none() -> DetectionBoxes:
    return _boxes("", (), Poses(np.empty((0, 4)), np.empty((0, 3))), np.empty((0, 3)), np.empty((0, 2)), np.empty(0))


def _boxes(
    sample: str, category: Iterable[str], poses: Poses, lwh_m: np.ndarray, velocity: np.ndarray, score: np.ndarray
) -> DetectionBoxes:
    names = np.array(list(category), dtype=object)
    samples = np.full(len(names), sample, dtype=object)
    return DetectionBoxes.from_poses(samples, names, poses, lwh_m, velocity_mps=velocity, score=score)


def _truth(sample: str, view: RenderView, inputs: ScoringInputs, config: DetectionConfig) -> DetectionBoxes:
    frame, _ = inputs.truth.recorded_frame_and_image(view)
    boxes = frame.boxes("ego")
    rows = np.flatnonzero(np.isin(np.array(boxes.category, dtype=object), list(config.class_range)))
    if not len(rows):
        return _none()
    names = [boxes.category[row] for row in rows]
    velocity = boxes.velocity_mps[rows, :2]
    return _boxes(sample, names, boxes.pose[rows], boxes.size_m[rows], velocity, np.zeros(len(rows)))


def _predicted(sample: str, frame: DetectedFrame | None, config: DetectionConfig) -> DetectionBoxes:
    if frame is None or not frame.boxes:
        return _none()
    numbers = np.array([box.ego_SE3_box for box in frame.boxes])
    velocity = np.array([box.velocity_mps or (np.nan, np.nan) for box in frame.boxes])
    sizes, scores = np.array([box.size_m for box in frame.boxes]), np.array([box.score for box in frame.boxes])
    names = [box.category for box in frame.boxes]
    return _boxes(sample, names, Poses(numbers[:, :4], numbers[:, 4:]), sizes, velocity, scores)


def _figures(group: str, found: NuScenesDetection, count: int) -> Iterable[Figure]:
    def figure(metric: str, value: float, reason: str | None, unit: str, *, lower: bool = False) -> Figure:
        return Figure(
            metric=metric,
            group=group,
            value=finite_or_none(value),
            reason=reason,
            unit=unit,
            better="lower" if lower else "higher",
            n=count,
            interval_reason="a figure of all boxes together",
        )

    errors = {name: found.tp_errors[name] for name in _ERRORS}
    yield figure("mean_ap", found.mean_ap, found.mean_ap.reason, "")
    for name, (title, unit) in _ERRORS.items():
        yield figure(title, errors[name], errors[name].reason, unit, lower=True)
    reasons = [score.reason for score in (found.mean_ap, *errors.values()) if score.reason is not None]
    weight = found.config.mean_ap_weight
    total = weight * found.mean_ap + sum(max(0.0, 1.0 - error) for error in errors.values())
    yield figure("nds_no_attr", total / (weight + len(errors)), reasons[0] if reasons else None, "")
    for name, row in zip(found.config.class_range, found.label_aps):
        if name not in found.absent_classes:
            yield figure(f"ap_{name}", float(np.mean(row)), None, "")


SCORER: Final = Annotation()
