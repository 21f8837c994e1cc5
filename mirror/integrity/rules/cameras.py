"""Rules of CAM: calibrations and rigs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mirror.geometry.cameras import COEFFICIENTS, Camera
from mirror.geometry.quaternions import angle_between_deg, quaternion_normalise, rotate
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.motion import MotionColumns
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView

_MIN, _MAX = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@scene_rule(
    "CAM001",
    Severity.ERROR,
    title=(
        "No calibration of a camera, of any stage, is valid when one of its images was taken, and the recording does"
        " not declare the camera uncalibrated."
    ),
    remedy="give the recording a calibration of that camera for that time, `mirror ingest RECORDING... --replace`",
)
def _calibrated(view: SceneView) -> Iterator[Finding]:
    images, calibrations = view.images, view.calibrations
    # Where the table of calibrations cannot be read, another rule says so.
    bad = np.isin(images.traversal, [number for _, number, _ in calibrations.parts])
    start = np.where(calibrations.is_known("valid_from_ns"), calibrations.integers("valid_from_ns"), _MIN)
    end = np.where(calibrations.is_known("valid_to_ns"), calibrations.integers("valid_to_ns"), _MAX)
    stamps = images.integers("timestamp_ns")
    for row, own, same_camera in view.calibrated_images():
        bad[own] &= ~(same_camera & (stamps[own] >= start[row]) & (stamps[own] <= end[row]))
    camera, names = images.text_codes("camera")
    for number, item in enumerate(view.traversals):
        declared = [code for code, name in enumerate(names) if name in item.drive.uncalibrated_cameras]
        if declared:
            bad &= ~((images.traversal == number) & np.isin(camera, declared))
    yield from images.findings(bad, lambda row: "no calibration of the camera is valid at this time")


@scene_rule(
    "CAM002",
    Severity.ERROR,
    title="An image is of another size than its camera is calibrated for.",
    remedy="scale the calibration to the stored raster, and `mirror ingest RECORDING... --replace`",
)
def _raster(view: SceneView) -> Iterator[Finding]:
    images, calibrations = view.images, view.calibrations
    width, height = images.integers("width_px"), images.integers("height_px")
    across, down = calibrations.integers("width_px"), calibrations.integers("height_px")
    calibrated = np.full(len(images), -1, np.int64)
    for row, own, same_camera in view.calibrated_images():
        other = same_camera & ((width[own] != across[row]) | (height[own] != down[row]))
        calibrated[own] = np.where(other, row, calibrated[own])
    yield from images.findings(
        calibrated >= 0,
        lambda row: (
            f"{width[row]} x {height[row]} px, but calibrated"
            f" ({calibrations.text('stage', int(calibrated[row]))}) for"
            f" {across[calibrated[row]]} x {down[calibrated[row]]} px"
        ),
    )


@scene_rule(
    "CAM003",
    Severity.ERROR,
    title=("Intrinsics that make no camera: a focal length that is not positive, or a wrong number of coefficients."),
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def _no_camera(view: SceneView) -> Iterator[Finding]:
    calibrations = view.all_calibrations
    bad = np.zeros(len(calibrations), np.bool_)
    for row in view.camera_errors:
        # A model that nobody knows is an unknown word.
        bad[row] = calibrations.text("model", row) in COEFFICIENTS
    yield from calibrations.findings(bad, lambda row: str(view.camera_errors[row]))


_FOCAL = (0.1, 20.0)
_ASPECT = 0.1


_CENTRE = 0.25


@scene_rule(
    "CAM004",
    Severity.WARNING,
    title=("Intrinsics that no common lens has: focal length, its aspect, or the principal point far from the middle."),
    remedy="check the calibration's units, and which raster it is for",
)
def _implausible_lens(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    width, height = rows.integers("width_px"), rows.integers("height_px")
    fx, fy, cx, cy = (rows.floats(name) for name in ("fx_px", "fy_px", "cx_px", "cy_px"))
    codes, words = rows.text_codes("model")
    f_theta = np.isin(codes, [code for code, word in enumerate(words) if word == "f_theta"])
    share, aspect = fx / width, fy / fx
    off = np.maximum(np.abs(cx / width - 0.5), np.abs(cy / height - 0.5))
    lens = ~f_theta & ((share < _FOCAL[0]) | (share > _FOCAL[1]) | (np.abs(aspect - 1.0) > _ASPECT))
    sane = np.ones(len(rows), np.bool_)
    sane[list(view.camera_errors)] = False
    yield from rows.findings(
        sane & (lens | (off > _CENTRE)),
        lambda row: (
            f"fx {fx[row]:g}, fy {fy[row]:g}, cx {cx[row]:g}, cy {cy[row]:g} px of {width[row]} x {height[row]} px"
        ),
    )


@scene_rule(
    "CAM005",
    Severity.WARNING,
    title="The distortion folds back within the image: beyond that radius no pixel has a ray.",
    remedy="calibrate with targets up to the corners; projections are invalid beyond",
)
def _distortion_range(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    share = {camera: _valid_share(camera) for camera in set(view.cameras.values())}
    reached = np.ones(len(rows))
    for row, camera in view.cameras.items():
        reached[row] = share[camera]
    yield from rows.findings(
        reached < 1.0,
        lambda row: f"valid only up to {reached[row]:.0%} of the way from the principal point to an edge's middle",
        worst=-reached,
    )


def _valid_share(camera: Camera) -> float:
    """Return the share of the ways from the principal point to the middles of the edges that has rays.

    Not to the corners: those of a fisheye are dark.
    """
    across = np.linspace(0.0, 1.0, 33)[:, None, None]
    x, y = camera.cx_px, camera.cy_px
    ends = np.array([[0.0, y], [camera.width_px, y], [x, 0.0], [x, camera.height_px]])
    seen = camera.unproject((x, y) + across * (ends - (x, y))).valid.all(axis=1)
    return 1.0 if seen.all() else float(across[max(int(np.argmin(seen)) - 1, 0), 0, 0])


@scene_rule(
    "CAM006",
    Severity.ERROR,
    title="A camera's mounting is no pose: a number is not finite, or the quaternion is not of unit length.",
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def _mounting(view: SceneView) -> Iterator[Finding]:
    mounted = MotionColumns(view.all_calibrations)
    bad = ~(mounted.unit & np.isfinite(mounted.position).all(axis=1))
    yield from view.all_calibrations.findings(
        bad,
        lambda row: f"quaternion {mounted.rotation[row].tolist()}, translation {mounted.position[row].tolist()}",
    )


_TOLERANCE = 1e-9


@scene_rule(
    "CAM007",
    Severity.ERROR,
    title="A mounting's covariance is not a 6x6 matrix that is symmetric and has no negative eigenvalue.",
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def _covariance(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    why: dict[int, str] = {}
    for row in np.flatnonzero(rows.is_known("covariance")).tolist():
        values = np.array(rows.data.column("covariance")[row].as_py(), np.float64)
        if values.shape != (36,) or not np.isfinite(values).all():
            why[row] = f"{len(values)} values, {np.isfinite(values).sum()} of them finite; expected 36"
            continue
        matrix = values.reshape(6, 6)
        scale = np.abs(matrix).max()
        lowest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0]
        if np.abs(matrix - matrix.T).max() > _TOLERANCE * scale:
            why[row] = "not symmetric"
        elif lowest < -_TOLERANCE * scale:
            why[row] = f"smallest eigenvalue {lowest:.3g}; expected at least 0"
    bad = np.zeros(len(rows), np.bool_)
    bad[list(why)] = True
    yield from rows.findings(bad, lambda row: why[row])


@scene_rule(
    "CAM008",
    Severity.ERROR,
    title="Two calibrations of one camera and stage are valid at once, or one ends before it begins.",
    remedy="correct the intervals in the recording, and `mirror ingest RECORDING... --replace`",
)
def _validity(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    start = np.where(rows.is_known("valid_from_ns"), rows.integers("valid_from_ns"), _MIN)
    end = np.where(rows.is_known("valid_to_ns"), rows.integers("valid_to_ns"), _MAX)
    order = np.lexsort((end, start, rows.text_codes("stage")[0], rows.text_codes("camera")[0], rows.owner))
    same = np.zeros(len(rows), np.bool_)
    same[order[1:]] = True
    for codes in (rows.owner, rows.text_codes("camera")[0], rows.text_codes("stage")[0]):
        same[order[1:]] &= codes[order[1:]] == codes[order[:-1]]
    # The last instant of one may be the first of the next.
    overlapping = np.zeros(len(rows), np.bool_)
    overlapping[order[1:]] = same[order[1:]] & (start[order[1:]] < end[order[:-1]])
    inverted = end < start
    yield from rows.findings(
        overlapping | inverted,
        lambda row: "ends before it begins" if inverted[row] else "begins before the one before it ends",
    )


_PAIRS = (("front_left", "front_right"), ("rear_left", "rear_right"))
_PLACE_M = 0.5


_ANGLE_DEG = 15.0


@scene_rule(
    "CAM009",
    Severity.WARNING,
    title=("A left and a right camera are not mirror images of each other, by over half a metre or 15 degrees."),
    remedy="check whether left and right are exchanged, or the mounting's frame is another",
)
def _symmetry(view: SceneView) -> Iterator[Finding]:
    rows = view.calibrations
    mounted = MotionColumns(rows)
    cameras, names = rows.text_codes("camera")
    stages = rows.text_codes("stage")[0]
    usable = mounted.unit & np.isfinite(mounted.position).all(axis=1)
    for file, _, own in rows.slices():
        for left_name, right_name in _PAIRS:
            if left_name not in names or right_name not in names:
                continue
            index = np.arange(own.start, own.stop)[usable[own]]
            left = index[cameras[index] == names.index(left_name)]
            right = index[cameras[index] == names.index(right_name)]
            for one in left.tolist():
                other = right[stages[right] == stages[one]][:1].tolist()
                if other and (why := _difference(mounted, one, other[0])):
                    yield Finding(file, f"cameras {left_name} and {right_name}", why)
                    break


def _difference(mounted: MotionColumns, left: int, right: int) -> str | None:
    """Describe how a pair differs from being mirrored at the plane y = 0; None: it does not."""
    mirror = np.array([1.0, -1.0, 1.0])
    place = float(np.linalg.norm(mounted.position[left] - mirror * mounted.position[right]))
    axis = rotate(quaternion_normalise(mounted.rotation[[left, right]]), np.array([0.0, 0.0, 1.0]))
    cosine = float(np.clip(axis[0] @ (mirror * axis[1]), -1.0, 1.0))
    angle = float(np.degrees(np.arccos(cosine)))
    exchanged = mounted.position[left, 1] < mounted.position[right, 1]
    if place <= _PLACE_M and angle <= _ANGLE_DEG and not exchanged:
        return None
    return f"{place:.2f} m and {angle:.1f} degrees apart when one is mirrored" + (
        ", and the left one is right of the other" if exchanged else ""
    )


_LIMIT_DEG = 0.3


@scene_rule(
    "CAM010",
    Severity.INFO,
    title=("Calibration stages disagree about a camera's direction by more than 0.3 degrees, the paper's bound."),
    remedy="nothing, if the later stage is the better one; else measure both",
)
def _stages(view: SceneView) -> Iterator[Finding]:
    rows = view.calibrations
    mounted = MotionColumns(rows)
    differ = np.zeros(len(rows), np.bool_)
    angle = np.zeros(len(rows))
    compared = rows.same_group("camera") & mounted.unit
    compared[1:] &= mounted.unit[:-1] & (rows.text_codes("stage")[0][1:] != rows.text_codes("stage")[0][:-1])
    at = np.flatnonzero(compared)
    if len(at):
        rotation = quaternion_normalise(mounted.rotation[np.concatenate([at, at - 1])])
        angle[at] = angle_between_deg(rotation[: len(at)], rotation[len(at) :])
        differ = angle > _LIMIT_DEG
    yield from rows.findings(
        differ,
        lambda row: f"{angle[row]:.3f} degrees from stage {rows.text('stage', row - 1)}",
        worst=angle,
    )


@scene_rule(
    "CAM011",
    Severity.ERROR,
    title="Images are of a camera that the rig of their drive does not have.",
    remedy="add the camera to the rig in the recording, and `mirror ingest RECORDING... --replace`",
)
def _rig_cameras(view: SceneView) -> Iterator[Finding]:
    images = view.images
    cameras, names = images.text_codes("camera")
    bad = np.zeros(len(images), np.bool_)
    for _, number, rows in images.slices():
        rig = view.traversals[number].rig
        if rig is not None:
            foreign = [code for code, name in enumerate(names) if name not in {camera.name for camera in rig.cameras}]
            bad[rows] = np.isin(cameras[rows], foreign)
        elif view.traversals[number].drive.rig_id is None:
            bad[rows] = True
    yield from images.findings(
        bad,
        lambda row: f"camera {names[cameras[row]]} is not in rig {view.traversals[images.traversal[row]].drive.rig_id}",
    )


@scene_rule(
    "CAM012",
    Severity.WARNING,
    title="A camera of the rig has no image in a traversal that has images of others.",
    remedy="check the recording for the camera's images, then `mirror ingest RECORDING... --replace`",
)
def _silent_camera(view: SceneView) -> Iterator[Finding]:
    images = view.images
    cameras, names = images.text_codes("camera")
    for file, number, rows in images.slices():
        rig = view.traversals[number].rig
        there = {names[code] for code in np.unique(cameras[rows]).tolist()}
        silent = (
            [camera.name for camera in rig.cameras if camera.name not in there] if rig is not None and there else []
        )
        if silent:
            yield Finding(file, f"camera {silent[0]}", f"no image of {', '.join(silent)}", len(silent))


_JUMP_DEG = 0.3
_JUMP_M = 0.05


@scene_rule(
    "CAM013",
    Severity.WARNING,
    title="A camera's mounting jumps between two consecutive validity intervals, by over 0.3 degrees or 5 cm.",
    remedy="check for an impact or a repair at that time; compare the stages with `mirror calibrate check DATASET`",
)
def _jump(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    mounted = MotionColumns(rows)
    usable = mounted.unit & np.isfinite(mounted.position).all(axis=1)
    start = np.where(rows.is_known("valid_from_ns"), rows.integers("valid_from_ns"), _MIN)
    order = np.lexsort((start, rows.text_codes("stage")[0], rows.text_codes("camera")[0], rows.owner))
    same = usable[order[1:]] & usable[order[:-1]] & (start[order[1:]] > start[order[:-1]])
    for codes in (rows.owner, rows.text_codes("camera")[0], rows.text_codes("stage")[0]):
        same &= codes[order[1:]] == codes[order[:-1]]
    later, earlier = order[1:][same], order[:-1][same]
    angle, distance = np.zeros(len(rows)), np.zeros(len(rows))
    if len(later):
        angle[later] = angle_between_deg(
            quaternion_normalise(mounted.rotation[later]), quaternion_normalise(mounted.rotation[earlier])
        )
        distance[later] = np.linalg.norm(mounted.position[later] - mounted.position[earlier], axis=1)
    yield from rows.findings(
        (angle > _JUMP_DEG) | (distance > _JUMP_M),
        lambda row: f"{angle[row]:.3f} degrees and {100.0 * distance[row]:.1f} cm from the interval before",
        worst=angle,
    )


@scene_rule(
    "CAM014",
    Severity.WARNING,
    title="A refined calibration has no covariance: its uncertainty is unknown.",
    remedy="refine it with a method that states its uncertainty",
)
def _refined_without_covariance(view: SceneView) -> Iterator[Finding]:
    rows = view.all_calibrations
    codes, words = rows.text_codes("stage")
    refined = np.isin(codes, [code for code, word in enumerate(words) if word == "refined"])
    yield from rows.findings(refined & ~rows.is_known("covariance"), lambda row: "no covariance")


@scene_rule(
    "CAM016",
    Severity.ERROR,
    title=(
        "A rolling shutter that the camera cannot have: its readout is longer than the period of its images, or the"
        " raster has a single line in its direction."
    ),
    remedy="correct shutter_direction and readout_ns in the recording, and `mirror ingest RECORDING... --replace`",
)
def _impossible_shutter(view: SceneView) -> Iterator[Finding]:
    calibrations, stamps = view.calibrations, view.images.integers("timestamp_ns")
    readout = calibrations.integers("readout_ns")
    width, height = calibrations.integers("width_px"), calibrations.integers("height_px")
    period = np.zeros(len(calibrations), np.int64)
    for row, own, same_camera in view.calibrated_images():
        gaps = np.diff(np.unique(stamps[own][same_camera]))
        period[row] = int(np.median(gaps)) if len(gaps) else 0
    codes, words = calibrations.text_codes("shutter_direction")
    sideways = np.isin(codes, [code for code, word in enumerate(words) if word in ("left_to_right", "right_to_left")])
    rolls = (readout > 0) & ~np.isin(codes, [code for code, word in enumerate(words) if word == "global"])
    single = rolls & (np.where(sideways, width, height) < 2)
    long = rolls & (period > 0) & (readout > period)
    yield from calibrations.findings(
        single | long,
        lambda row: (
            f"a raster of {width[row]} x {height[row]} px has no such direction"
            if single[row]
            else f"a readout of {readout[row] * 1e-6:g} ms; images are {period[row] * 1e-6:g} ms apart"
        ),
    )


_REFINED_FROM = ("poses", "calibrations", "boxes", "masks", "redaction")


@scene_rule(
    "CAM015",
    Severity.ERROR,
    title="A layer of calibrations was made from traversals or layers that have changed or are gone since.",
    remedy="`mirror calibrate refine DATASET --version NAME`, and remove the old layer",
)
def _refined_from_changed(view: SceneView) -> Iterator[Finding]:
    layout = view.dataset.layout
    for item in view.traversals:
        for kind, source, version in item.layers:
            manifest = None
            if kind == "calibrations":
                manifest = view.dataset.folder_manifests.get(layout.layer(item.traversal_id, kind, source, version))
            for key, value in {} if manifest is None else manifest.derived_from.items():
                folder = _input_folder(view, key)
                if folder is None:
                    continue
                present = view.dataset.folder_manifests.get(folder)
                if present is None or present.content != value:
                    what = "is gone" if present is None else "has changed"
                    name = view.dataset.name(layout.layer(item.traversal_id, kind, source, version))
                    yield Finding(name, "derived_from", f"stale: {view.dataset.name(folder)} {what}")
                    break


def _input_folder(view: SceneView, key: str) -> Path | None:
    """The folder whose hash a layer records under a key; None: the key names no folder."""
    what, _, traversal_id = key.partition(":")
    if what == "traversal":
        return view.dataset.layout.recorded(traversal_id)
    kind, _, name = what.partition("/")
    source, _, version = name.partition("@")
    if kind not in _REFINED_FROM or not (version and traversal_id):
        return None
    return view.dataset.layout.layer(traversal_id, kind, source, version)
