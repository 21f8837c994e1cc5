"""``mirror calibrate``: ``check DATASET``, ``refine DATASET``, and ``intrinsics FOLDER`` of its own module."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.calibration.check import CalibrationCheck, CameraCheck
    from mirror.calibration.refinement.report import RefinementReport
    from mirror.calibration.refinement.summary import CameraRefinement
    from mirror.calibration.rig import PosePrior
    from mirror.dataset.dataset import Dataset

_CHECK_EXAMPLES = (
    "mirror calibrate check demo/calibration/dataset --out calibration",
    "mirror calibrate check demo/calibration/dataset --stage factory --out calibration-factory --json",
)
_REFINE_EXAMPLES = (
    "mirror calibrate refine demo/calibration/dataset",
    "mirror calibrate refine demo/calibration/dataset --frames 20 --version 20-frames --json",
)

_OPTIONS = {
    "attitude_deg": "--pose-sigma-deg", "position_m": "--pose-sigma-m", "drift_m": "--pose-drift-m",
    "focal_percent": "--focal-sigma-percent", "way_percent": "--way-sigma-percent", "offset_m": "--offset-m",
}  # fmt: skip
"""The options that state the fields of priors, by the name of the field."""


@contextmanager
def _named_options() -> Iterator[None]:
    """Name the option at fault in errors that name the field of a prior."""
    try:
        yield
    except UsageError as error:
        error.place = _OPTIONS.get(error.place or "", error.place)
        raise


@dataclass(frozen=True)
class InputOptions:
    """The inputs of a calibration check: traversals, layers, and errors that recorded poses may have."""

    stage: Annotated[
        Literal["factory", "online", "refined"] | None, help_text(default="the best of each camera", metavar="STAGE")
    ] = None
    """Stage of the calibrations: factory, online or refined."""
    calibrations: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of calibrations."""
    poses: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of poses."""
    boxes: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of boxes, which mask moving road users."""
    scene: Annotated[str | None, help_text(default="all", metavar="ID")] = None
    """Scene to read."""
    pose_sigma_m: float = 0.005
    """White noise of the recorded positions, 1-sigma along each axis, metres."""
    pose_drift_m: float = 0.03
    """Smooth drift of the recorded positions over some seconds, 1-sigma along each axis, metres."""
    pose_sigma_deg: float = 0.03
    """Noise of the recorded rotations, 1-sigma about each axis, degrees."""

    def choose(self, dataset: Dataset) -> Dataset:
        """Choose the part of a dataset that is read."""
        view = dataset.with_layers(poses=self.poses, calibrations=self.calibrations, stage=self.stage, boxes=self.boxes)
        return view if self.scene is None else view.where(scene=self.scene)

    def pose_prior(self) -> PosePrior:
        """Return the errors that the recorded poses may have."""
        from mirror.calibration.rig import PosePrior

        return PosePrior(attitude_deg=self.pose_sigma_deg, position_m=self.pose_sigma_m, drift_m=self.pose_drift_m)


@dataclass(frozen=True)
class CalibrationCheckArguments:
    """Estimate the calibration errors of all cameras from images, and compare the calibration stages.

    Writes report.html and calibration.json. An interrupted check continues. Nothing in the dataset is changed.
    Exit codes: 0 no error above 0.3 degrees and no wrong shutter was found, 1 some, 2 could not run or no camera could
    be checked, 3 some data could not be read.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FOLDER")] = Path("calibration")
    """Folder of the report."""
    input: tyro.conf.OmitArgPrefixes[InputOptions] = field(default_factory=InputOptions)
    reference_poses: Annotated[str | None, help_text(default="none", metavar="SOURCE@VERSION")] = None
    """Layer of better poses, to measure the localisation drift."""
    frames: int = 20
    """Number of frames per traversal."""
    step_m: float = 3.5
    """Distance between neighbouring frames on a straight road, metres; on bends 12 degrees."""
    focal_sigma_percent: float = 0.5
    """Error of the recorded focal lengths, 1-sigma, percent."""
    way_sigma_percent: float = 0.5
    """Error of the length of the recorded way, 1-sigma, percent."""
    json: bool = False
    """Print the result as JSON."""


@dataclass(frozen=True)
class Refine:
    """Adjust mountings and lenses of all cameras to matched features, and write them as a layer of calibrations.

    The layer refined@VERSION has stage refined, covariances and the hashes of what it came from; no other layer and no
    recorded calibration is changed. An interrupted refinement continues. Exit codes: 0 all was refined, 2 could not
    run, 3 some cameras or traversals keep their calibration.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    version: Annotated[str, help_text(metavar="NAME")] = "1"
    """Version of the layer refined@VERSION; an existing layer is kept."""
    input: tyro.conf.OmitArgPrefixes[InputOptions] = field(default_factory=InputOptions)
    frames: int = 12
    """Number of frames per traversal."""
    step_m: float = 2.0
    """Distance between neighbouring frames on a straight road, metres; on bends 8 degrees."""
    offset_m: float = 0.05
    """Offset between the recorded positions of two traversals, 1-sigma along each axis, metres."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "check": Subcommand("estimate calibration errors from images, with a report page", _check),
        "refine": Subcommand("adjust the calibrations to the images, and write them as a layer", _refine),
        "intrinsics": Subcommand("estimate the lens of a camera from images of a calibration board", _intrinsics),
    }
    return run_subcommand(argv, "mirror calibrate", subcommands)


def _intrinsics(argv: Sequence[str]) -> int:
    from mirror.cli.calibrate_intrinsics import main as run

    return run(argv)


def _check(argv: Sequence[str]) -> int:
    arguments = parse_arguments(CalibrationCheckArguments, argv, "mirror calibrate check", examples=_CHECK_EXAMPLES)

    from mirror.calibration.check import check_calibration
    from mirror.calibration.frame_choice import FrameChoice
    from mirror.calibration.rig import ScalePrior
    from mirror.dataset import open as open_dataset
    from mirror.progress import progress_bar
    from mirror.schema.files import write_bytes
    from mirror.schema.folders import find_kind
    from mirror.view.calibration_page import write_calibration_page

    # A folder with the work of an interrupted check alone has no kind.
    find_kind(arguments.out)
    with _named_options():
        prior = arguments.input.pose_prior()
        scales = ScalePrior(arguments.focal_sigma_percent, arguments.way_sigma_percent)
    choice = FrameChoice(frames=arguments.frames, step_m=arguments.step_m)
    dataset = arguments.input.choose(open_dataset(arguments.dataset))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with progress_bar(quiet=arguments.json) as bar:
        check = check_calibration(
            dataset, choice=choice, prior=prior, scales=scales, reference_poses=arguments.reference_poses,
            work=arguments.out / "traversals", progress=bar,
        )  # fmt: skip
    plain = check.to_dict()
    write_bytes(arguments.out / "calibration.json", (json.dumps(plain, indent=1) + "\n").encode())
    write_calibration_page(check, arguments.out / "report.html")
    if arguments.json:
        print(json.dumps({**plain, "report": str(arguments.out / "report.html")}))
    else:
        _print_check(check, arguments.out)
    return check.exit_code()


def _print_check(check: CalibrationCheck, out: Path) -> None:
    from mirror.cli.output import plain_console

    console = plain_console(soft_wrap=True)
    for item in check.traversals:
        if item.message:
            console.print(f"{item.traversal_id}: {item.status}: {item.message}")
            continue
        console.print(
            f"{item.traversal_id}: {item.frames} frames, {item.driven_m:.0f} m, turned {item.turned_deg:.0f} degrees, "
            f"recorded way {item.way_error_percent:+.2f} +- {item.way_sigma_percent:.2f} % too long"
        )
        for one in item.cameras:
            angle = "--" if one.angle_deg is None else f"{one.angle_deg:.3f}"
            axes = "" if one.status == "unobservable" else f"; {', '.join(one.unobservable_axes())} unobservable"
            note = f"{axes}: {one.reason}" if one.reason else ""
            lens = f"focal length {one.focal_error_percent:+.2f} +- {one.focal_sigma_percent:.2f} %"
            console.print(f"  {one.camera:<13} {one.stage:<8} {angle:>6} degrees  {one.status}{note}; {lens}")
            console.print(f"  {'':<13} {_describe_times(one)}")
        for message in item.unread:
            console.print(f"  could not read: {message}")
    found = check.statistics
    jumps = sum(one.is_jump for one in check.history.in_time)
    console.print(
        f"below 0.3 degrees: {found.cameras_below} of {found.cameras} cameras, {found.samples_below} of "
        f"{found.samples} traversals; jumps of a stage in time: {jumps}"
    )
    console.print(f"verdict: {found.verdict} (a pass needs {found.needed} traversals without a failure)")
    console.print(f"report: {out / 'report.html'}")


def _describe_times(one: CameraCheck) -> str:
    """The readout and the time offset of a camera, in words."""
    if one.readout_sigma_ms is None or one.offset_sigma_ms is None:
        return "readout and time offset: not known: much noise in the tracks; see `mirror calibrate refine`"

    from mirror.calibration.shutters import say_times

    return say_times(
        one.shutter, (one.readout_ms, one.readout_sigma_ms), (one.offset_ms, one.offset_sigma_ms), one.shutter_problem
    )


def _refine(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Refine, argv, "mirror calibrate refine", examples=_REFINE_EXAMPLES)

    from mirror.calibration.frame_choice import FrameChoice
    from mirror.calibration.refinement.rigs import RefinementPrior
    from mirror.calibration.refinement.run import DEFAULT_CHOICE, refine_calibrations
    from mirror.dataset.writing import open_to_write
    from mirror.progress import progress_bar

    dataset = arguments.input.choose(open_to_write(arguments.dataset))
    choice = FrameChoice(frames=arguments.frames, step_m=arguments.step_m, step_deg=DEFAULT_CHOICE.step_deg)
    with _named_options():
        prior = RefinementPrior(arguments.input.pose_prior(), offset_m=arguments.offset_m)
    with progress_bar(quiet=arguments.json) as bar:
        report = refine_calibrations(
            dataset, version=arguments.version, choice=choice, prior=prior, progress=bar
        )  # fmt: skip
    if arguments.json:
        print(json.dumps(report.to_dict()))
    else:
        _print_refinement(report, arguments)
    return report.exit_code()


def _print_refinement(report: RefinementReport, arguments: Refine) -> None:
    from mirror.cli.output import plain_console

    console = plain_console(soft_wrap=True)
    for item in report.traversals:
        if item.message or not item.cameras:
            console.print(f"{item.traversal_id}: {item.status}" + (f": {item.message}" if item.message else ""))
        else:
            console.print(f"{item.traversal_id}: {item.images} images of {item.frames} frames")
        for one in item.cameras:
            console.print(f"  {one.camera:<13} {_describe(one)}")
            if one.shutter is not None:
                console.print(f"  {'':<13} {one.shutter}")
        for message in item.unread:
            console.print(f"  could not read: {message}")
    if any(item.status in ("refined", "existing") for item in report.traversals):
        console.print(
            f"layer: calibrations/{report.layer}\n"
            f"next: mirror reconstruct {arguments.dataset} --calibrations {report.layer} --split NAME --out MODEL"
        )


def _describe(one: CameraRefinement) -> str:
    """The result of one camera in words."""
    if one.status != "refined":
        return f"keeps its calibration: {one.reason}"
    relative = f"was off by {one.relative_deg:.3f} +- {one.relative_sigma_deg:.3f} degrees relative to {one.reference}"
    axes = ", ".join(
        f"{axis} unobservable" if axis in one.held else f"{axis} {error:+.3f} +- {sigma:.3f}"
        for axis, error, sigma in zip(("roll", "pitch", "yaw"), one.vehicle_deg, one.vehicle_sigma_deg)
    )
    return f"{'is the reference' if one.camera == one.reference else relative}; to the vehicle {axes}"
