"""Checks the calibration of a dataset: estimates every traversal, and states the verdict on the fleet."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.calibration.estimate import AXES, CameraEstimate, estimate_rotations, explain
from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.localisation import LENGTHS_M, compute_drift
from mirror.calibration.rig import PosePrior, ScalePrior
from mirror.calibration.sampling import choose_frames, track_traversal
from mirror.calibration.shutters import ShutterEstimate, estimate_shutters
from mirror.calibration.stages import StageHistory, compare_stages
from mirror.calibration.statistics import LIMIT_DEG, FleetStatistics, compute_fleet_statistics, require_scipy
from mirror.calibration.tracking import TrackingOptions
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, ExitCode, MirrorError, UsageError
from mirror.geometry import interpolate
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.files import write_bytes
from mirror.schema.finished_work import hash_values
from mirror.schema.strict_json import decode_json

METHOD: Final = "joint epipolar estimate, 4"


@dataclass(frozen=True)
class CameraCheck:
    """The reported estimate of one camera in one traversal.

    Attributes:
        camera: the camera.
        stage: stage of the calibration that was checked.
        error_deg: roll, pitch, yaw of the error about the vehicle's axes.
        sigma_deg: their standard deviations.
        observable: whether each is known to 0.1 degrees.
        angle_deg: total angle over the observable axes; None: no axis is observable.
        status: ``ok``, ``fail`` (above 0.3 degrees), or ``unobservable``: no axis is.
        reason: why an axis is unobservable; None: all are.
        tracks: number of tracks.
        residual_px: median distance from the epipolar lines; None without tracks.
        focal_error_percent: by how much the recorded focal length is too large.
        focal_sigma_percent: its standard deviation.
        source: largest source of the variance of roll, pitch and yaw.
        source_share: its share of that variance, 0 to 1.
        shutter: direction that the images show; None: they show none.
        readout_ms: readout in that direction, or in the declared one.
        readout_sigma_ms: its standard deviation; None: the tracks have too much noise to show the times.
        offset_ms: how much later than its timestamps the camera exposes.
        offset_sigma_ms: its standard deviation; the offset is known only where the vehicle changes its turn or speed.
        shutter_problem: a declared readout or direction that the images contradict; None: they do not.
    """

    camera: str
    stage: str
    error_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    observable: tuple[bool, bool, bool]
    angle_deg: float | None
    status: str
    reason: str | None
    tracks: int
    residual_px: float | None
    focal_error_percent: float
    focal_sigma_percent: float
    source: tuple[str, str, str]
    source_share: tuple[float, float, float]
    shutter: str | None = None
    readout_ms: float = 0.0
    readout_sigma_ms: float | None = None
    offset_ms: float = 0.0
    offset_sigma_ms: float | None = None
    shutter_problem: str | None = None

    def unobservable_axes(self) -> list[str]:
        """Return the names of the axes about which the rotation error is unknown."""
        return [axis for axis, known in zip(AXES, self.observable) if not known]


@dataclass(frozen=True)
class TraversalCheck:
    """The check of one traversal.

    Attributes:
        traversal_id: the traversal.
        vehicle_id: its vehicle.
        drive_id: its drive.
        entry_ns: when it began.
        light: day, dusk or night.
        status: ``checked``, ``not checked`` (no motion, too few frames) or ``failed`` (data could not be read).
        message: why it was not checked; None: it was.
        frames: number of frames used.
        driven_m: way over these frames.
        turned_deg: change of course over these frames.
        way_error_percent: by how much the recorded way is too long; None: it was not checked.
        way_sigma_percent: its standard deviation.
        cameras: the estimates.
        unread: messages of images that could not be read.
        drift_percent: drift against the reference poses, by length in metres: median percent; empty without reference.
    """

    traversal_id: str
    vehicle_id: str
    drive_id: str
    entry_ns: int
    light: str
    status: str
    message: str | None = None
    frames: int = 0
    driven_m: float = 0.0
    turned_deg: float = 0.0
    way_error_percent: float | None = None
    way_sigma_percent: float | None = None
    cameras: tuple[CameraCheck, ...] = ()
    unread: tuple[str, ...] = ()
    drift_percent: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CalibrationCheck:
    """The check of a dataset.

    Attributes:
        dataset: path of the dataset.
        traversals: the checks of the traversals.
        statistics: the errors of the fleet.
        history: the stages beside each other.
    """

    dataset: str
    traversals: Sequence[TraversalCheck]
    statistics: FleetStatistics
    history: StageHistory

    def exit_code(self) -> ExitCode:
        """Return 1 for an error above the limit or a wrong shutter, 3 for unread data, 2 without a sample, else 0."""
        cameras = [one for item in self.traversals for one in item.cameras]
        if any(one.status == "fail" or one.shutter_problem for one in cameras):
            return ExitCode.FINDINGS
        if any(item.status == "failed" or item.unread for item in self.traversals):
            return ExitCode.PARTLY_DONE
        # A script that asks for 0 must not take a dataset of which nothing is known for a good one.
        return ExitCode.DONE if self.statistics.samples else ExitCode.COULD_NOT_RUN

    def to_dict(self) -> dict[str, Any]:
        """Return the check as plain values, for JSON."""
        return {
            "dataset": self.dataset,
            "method": METHOD,
            "limit_deg": LIMIT_DEG,
            "definition": "angle between the delivered mounting and its estimate from images, a camera and traversal",
            "statistics": _finite(asdict(self.statistics)),
            "traversals": [_finite(asdict(one)) for one in self.traversals],
            "between_stages": [asdict(one) for one in self.history.between_stages],
            "jumps": [asdict(one) for one in self.history.in_time if one.is_jump],
            "exit_code": int(self.exit_code()),
        }


def check_calibration(
    dataset: Dataset,
    *,
    choice: FrameChoice | None = None,
    prior: PosePrior | None = None,
    scales: ScalePrior | None = None,
    options: TrackingOptions | None = None,
    reference_poses: str | None = None,
    work: Path | None = None,
    progress: ProgressReporter | None = None,
) -> CalibrationCheck:
    """Estimate the calibration errors of every traversal with images.

    Args:
        dataset: the dataset, or a view of it; its layers choose poses, calibrations, stage and boxes.
        choice: which frames of a traversal are used.
        prior: errors that the recorded poses may have.
        scales: errors that the recorded focal lengths and the length of the recorded way may have.
        options: settings of the tracker.
        reference_poses: a layer of better poses, to measure the drift of the chosen ones; None: no drift.
        work: folder for the finished traversals, so that an interrupted check continues; None: none.
        progress: receives the progress.

    Raises:
        UsageError: no traversal has images, the layer of reference poses does not exist, or scipy is not installed.
    """
    require_scipy()
    chosen, tracker = choice or FrameChoice(), options or TrackingOptions()
    priors = prior or PosePrior(), scales or ScalePrior()
    rows = [row for row in dataset.table("traversals").to_pylist() if row["has_images"]]
    if not rows:
        raise UsageError("no traversal has images", expected="images to check the calibration with")
    reference = None if reference_poses is None else dataset.with_layers(poses=reference_poses)
    settings = json.dumps([METHOD, dataset.index_sha256, asdict(dataset.layers), reference_poses,
                           *(asdict(one) for one in (chosen, *priors, tracker))])  # fmt: skip
    hashes = ContentHashes(dataset.store)
    reporter = progress or NullProgress()
    reporter.start("traversals", len(rows))
    checks = []
    for row in rows:
        one = dataset.where(traversal=row["traversal_id"])
        file = None
        if work is not None:
            images = _hash_images(one, chosen, hashes)
            inputs = hash_values(settings, row["traversal_id"], hashes.rig(row["rig_id"]), images)
            file = work / f"{inputs[:32]}.json"
        if file is not None and file.is_file():
            checks.append(_from_plain(decode_json(file.read_text())))
        else:
            other = None if reference is None else reference.where(traversal=row["traversal_id"])
            checks.append(_check_traversal(one, row, chosen, priors, tracker, other))
            # What could not be read is tried again by the next run.
            if file is not None and checks[-1].status != "failed" and not checks[-1].unread:
                write_bytes(file, json.dumps(asdict(checks[-1])).encode())
        reporter.advance(1)
    return CalibrationCheck(dataset.root, checks, _statistics(checks), compare_stages(dataset))


def _hash_images(view: Dataset, choice: FrameChoice, hashes: ContentHashes) -> str:
    """Hash the images that the check of a traversal reads; one that cannot be read has no hash."""
    try:
        return hash_values([hashes.frame(frame, "") for frame in choose_frames(view, choice)])
    except MirrorError:
        # The check states why no frames can be chosen; it reads no image then.
        return ""


def _check_traversal(
    dataset: Dataset,
    row: Mapping[str, Any],
    choice: FrameChoice,
    priors: tuple[PosePrior, ScalePrior],
    options: TrackingOptions,
    reference: Dataset | None,
) -> TraversalCheck:
    about = {name: row[name] for name in ("traversal_id", "vehicle_id", "drive_id", "entry_ns", "light")}
    _require_one_box_layer(dataset)
    unread: list[str] = []
    try:
        frames = choose_frames(dataset, choice)
        tracked = track_traversal(dataset, frames, unread, options)
        estimates = estimate_rotations(tracked.rig, *priors)
        shutters = estimate_shutters(tracked.rig, *priors)
        drift = {} if reference is None else _drift(dataset, reference)
    except UsageError as error:
        status = "failed" if unread else "not checked"
        return TraversalCheck(**about, status=status, message=str(error), unread=tuple(unread))
    except MirrorError as error:
        return TraversalCheck(**about, status="failed", message=str(error))
    cameras = [
        _camera_check(one, tracked.calibrations[one.camera].stage, explain(one, tracked.conditions), shutter)
        for one, shutter in zip(estimates, shutters, strict=True)
    ]
    return TraversalCheck(
        **about, status="checked", frames=tracked.frames, driven_m=tracked.conditions.driven_m,
        turned_deg=tracked.conditions.turned_deg, way_error_percent=estimates[0].way.error_percent,
        way_sigma_percent=estimates[0].way.sigma_percent, cameras=tuple(cameras), unread=tuple(unread),
        drift_percent=drift,
    )  # fmt: skip


def _require_one_box_layer(dataset: Dataset) -> None:
    """Raise a UsageError where several box layers exist and none was chosen: that is no fault of a traversal."""
    frames = dataset.frames()
    if len(frames):
        with contextlib.suppress(DatasetError):
            frames[0].boxes()


def _camera_check(one: CameraEstimate, stage: str, reason: str | None, shutter: ShutterEstimate) -> CameraCheck:
    known = bool(one.observable.any())
    status = "unobservable" if not known else "fail" if one.angle_deg > LIMIT_DEG else "ok"
    error, sigma = one.error_deg.tolist(), one.sigma_deg.tolist()
    source, source_share = (tuple(part) for part in zip(*one.main_sources, strict=True))
    return CameraCheck(
        one.camera, stage, tuple(error), tuple(sigma), tuple(one.observable.tolist()), one.angle_deg if known else None,
        status, reason, one.tracks, one.residual_px if one.tracks else None, one.focal.error_percent,
        one.focal.sigma_percent, source=source, source_share=source_share,
        shutter=shutter.direction, readout_ms=shutter.readout_ms,
        readout_sigma_ms=_finite(shutter.readout_sigma_ms), offset_ms=shutter.offset_ms,
        offset_sigma_ms=_finite(shutter.offset_sigma_ms), shutter_problem=shutter.problem,
    )  # fmt: skip


def _drift(dataset: Dataset, reference: Dataset) -> dict[str, float]:
    frames = reference.frames()
    stamps, truth = frames[0].track
    own_stamps, poses = dataset.frames()[0].track
    inside = (stamps >= own_stamps[0]) & (stamps <= own_stamps[-1])
    if not inside.any():
        raise DatasetError(
            "the reference poses do not overlap the chosen ones in time",
            file=dataset.root,
            remedy="name another layer of poses with --reference-poses",
        )
    at = interpolate(own_stamps, poses, stamps[inside])
    drifts = {f"{length:g}": compute_drift(at, truth[inside], length) for length in LENGTHS_M}
    return {length: float(np.median(values)) for length, values in drifts.items() if len(values)}


def _statistics(checks: Sequence[TraversalCheck]) -> FleetStatistics:
    own = [(item, one) for item in checks for one in item.cameras if one.angle_deg is not None]
    angles = [one.angle_deg or 0.0 for _, one in own]
    sigma = [np.sqrt(sum(s**2 for s, known in zip(one.sigma_deg, one.observable) if known)) for _, one in own]
    return compute_fleet_statistics(
        [item.traversal_id for item, _ in own], [item.vehicle_id for item, _ in own], angles, sigma
    )


def _from_plain(plain: dict[str, Any]) -> TraversalCheck:
    cameras = tuple(CameraCheck(**_with_tuples(one)) for one in plain.pop("cameras"))
    return TraversalCheck(**{**plain, "cameras": cameras, "unread": tuple(plain["unread"])})


def _with_tuples(plain: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in plain.items()}


def _finite(value: Any) -> Any:
    """Plain values without NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {name: _finite(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
