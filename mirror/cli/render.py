"""``mirror render DATASET MODEL``: a submission, or images along a trajectory."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.arrays import UInt8
    from mirror.dataset.dataset import Dataset
    from mirror.methods.model import ModelFolder
    from mirror.protocols.views.view import RenderView

_VIDEOS = (".mp4", ".mkv")
_HZ = 10.0
_NO_VIDEOS = (".avi", ".gif", ".m4v", ".mov", ".mpeg", ".mpg", ".ogv", ".webm", ".wmv")

_EXAMPLES = (
    "mirror render demo/block/dataset demo/block/model --split novel --out submission",
    "mirror render demo/block/dataset demo/block/model --trajectory lane-shift:2 --cameras front_wide --out left.mp4",
)
_RENAMED = {"--dataset": "DATASET"}


@dataclass(frozen=True)
class Arguments:
    """Render a trained model: with --split a submission for `mirror evaluate`, with --trajectory a video or images.

    --split and --trajectory exclude each other. A submission has the views that a protocol asks for. A trajectory may
    leave the driven lines.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset: it has the poses and lenses. --appearance fit reads half of each image too."""
    model: Annotated[tyro.conf.Positional[tuple[Path, ...]], help_text(default="none", metavar="MODEL...")]
    """Folders that `mirror reconstruct` wrote: one for each scene of the split."""
    out: Annotated[Path, help_text(metavar="FOLDER|FILE.mp4")]
    """A new folder. For a trajectory also a video file."""
    split: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """Split to write a submission for. Excludes --trajectory."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "static-reconstruction"
    """Name of a protocol, or path of its .toml file."""
    masks: bool = True
    """--no-masks: road users are scored, by the protocol NAME-unmasked, for recordings without boxes and masks."""
    trajectory: Annotated[str | None, help_text(default="none")] = None
    """A traversal, lane-shift:METRES to its left, forward:METRES ahead of it, or a CSV or Parquet file of poses
    (qw qx qy qz tx_m ty_m tz_m in the world frame of the scene; timestamp_ns, or else --hz). Excludes --split."""
    traversal: Annotated[str | None, help_text(default="the first training traversal", metavar="ID")] = None
    """Traversal that gives a trajectory its rig, its line and its appearance."""
    cameras: Annotated[str | None, help_text(default="all of the rig", metavar="NAME,...")] = None
    """Cameras to render."""
    calibrations: Annotated[str | None, help_text(default="that of the training", metavar="SOURCE@VERSION")] = None
    """Layer of calibrations that places the cameras; recorded: none. A traversal without it has the recorded ones."""
    appearance: str = "nearest"
    """nearest, mean, fit, a traversal, a word for light or weather such as night, or sweep:A:B.
    For a trajectory also by camera: rear=night,front_wide=sweep:day:night. A submission keeps that of trained views."""
    headlights: Literal["on", "off"] = "on"
    """off: without the vehicle's headlights in appearances by dusk and night, for a model that knows them. For a
    trajectory."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of a method that is not installed: that of the training."""
    width: Annotated[int | None, help_text(default="that of the protocol", metavar="PIXELS")] = None
    """Largest width of images of a trajectory."""
    hz: Annotated[float | None, help_text(default=f"{_HZ:g}")] = None
    """Images per second of a trajectory."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that renders. auto: a GPU that torch and gsplat can use, else the CPU. The first line says which."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror render", examples=_EXAMPLES, renamed=_RENAMED)
    if (arguments.split is None) == (arguments.trajectory is None):
        both = arguments.split is not None
        raise UsageError(
            "--split and --trajectory exclude each other" if both else "neither --split nor --trajectory was given",
            expected="one of them: --split NAME for a submission, or --trajectory LINE for a video or images",
        )
    if arguments.width is not None and arguments.width < 1:
        raise UsageError(f"{arguments.width}", place="--width", expected="1 or more")
    if arguments.out.suffix.lower() in _NO_VIDEOS:
        raise UsageError(
            f"{arguments.out}", place="--out", expected=f"a folder, or a name that ends in {' or '.join(_VIDEOS)}"
        )
    if not arguments.model:
        raise UsageError("no model", place="MODEL", expected="a folder that `mirror reconstruct` wrote")

    from mirror.dataset import open as open_dataset
    from mirror.schema.folders import FolderKind, require_output_file, require_output_folder

    if arguments.trajectory is not None and _is_video(arguments.out):
        require_output_file(arguments.out)
    else:
        require_output_folder(arguments.out, FolderKind.SUBMISSION)
    dataset = open_dataset(arguments.dataset)
    return _trajectory(arguments, dataset) if arguments.trajectory is not None else _submission(arguments, dataset)


def _choose_device(arguments: Arguments, models: Mapping[str, ModelFolder]) -> str:
    """Choose the device of the models, which are by one method, and print it."""
    device = next(iter(models.values())).choose_device(arguments.device)
    if not arguments.json:
        print(device, flush=True)
    return device.name


def _is_video(out: Path) -> bool:
    return out.suffix.lower() in _VIDEOS


def _submission(arguments: Arguments, dataset: Dataset) -> int:
    from mirror.evaluation.scorers import load_scorer
    from mirror.evaluation.submission.models import plan_model_submission
    from mirror.methods.model import read_models
    from mirror.progress import progress_bar
    from mirror.protocols.document import format_file_option, load_protocol

    for option in ("traversal", "cameras", "width", "hz"):
        if getattr(arguments, option) is not None:
            raise UsageError(
                "it is for trajectories", place=f"--{option}",
                expected=f"no such option beside --split: protocol {arguments.protocol} defines a submission",
            )  # fmt: skip
    if arguments.headlights == "off":
        raise UsageError("off", place="--headlights", expected="on: a submission shows the street as it was recorded")
    for sign, subject in (("sweep:", "a sweep is"), ("=", "appearances by camera are")):
        if sign in arguments.appearance:
            raise UsageError(
                f"{subject} for trajectories", place="--appearance", expected="one appearance for all views"
            )
    models = read_models(arguments.model, arguments.method)
    device = _choose_device(arguments, models)
    protocol = load_protocol(arguments.protocol, masked=arguments.masks)
    submission = plan_model_submission(
        dataset, models, protocol, str(arguments.split),
        policy=arguments.appearance, calibrations=arguments.calibrations, device=device,
    )  # fmt: skip
    with progress_bar(quiet=arguments.json) as bar:
        count = submission.write(arguments.out, bar)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), "views": count, "method": submission.method}))
    else:
        more = format_file_option(arguments.protocol)
        more += " --hidden FOLDER" if load_scorer(protocol.task).hidden_use(submission.plan) != "unused" else ""
        print(f"{count} renders by {submission.method}: {arguments.out}")
        # A published dataset lacks the images that are scored.
        verb = "submission check" if dataset.where(withheld=True).count("images") else "evaluate"
        print(f"next: mirror {verb} {arguments.dataset} {arguments.out}{more}")
    return ExitCode.DONE


def _trajectory(arguments: Arguments, dataset: Dataset) -> int:
    from mirror.evaluation.submission.models import hash_models
    from mirror.methods.appearance import AppearancePolicy, require_known_appearance
    from mirror.methods.camera_policies import open_by_camera, parse_camera_policies
    from mirror.methods.capabilities import find_capabilities
    from mirror.methods.model import read_models
    from mirror.methods.model_document import require_matching_split
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views.trajectories import parse_trajectory, plan_views_along
    from mirror.schema.render_folder import start_render_folder

    pixels = load_protocol(arguments.protocol).pixels
    if arguments.width is not None:
        pixels = pixels.model_copy(update={"max_width_px": arguments.width})
    models = read_models(arguments.model, arguments.method)
    if len(models) != 1:
        raise UsageError(f"{len(models)} models", expected="one, for a trajectory")
    device = _choose_device(arguments, models)
    ((scene, model),) = models.items()
    name, document = model.name, model.document
    dataset = dataset.with_layers(poses=document.poses)
    require_matching_split(dataset, document.split, document)
    layer = arguments.calibrations or document.calibrations
    scene_dataset = dataset.where(scene=scene).with_layers(calibrations=layer)
    base = arguments.traversal or _base_traversal(scene_dataset, str(arguments.trajectory), document.split)
    cameras = None if arguments.cameras is None else arguments.cameras.split(",")
    hz = _HZ if arguments.hz is None else arguments.hz
    trajectory = parse_trajectory(scene_dataset, str(arguments.trajectory), base, hz).resample(hz)
    views = plan_views_along(scene_dataset, base, trajectory, pixels, cameras)
    rendered_cameras = sorted({view.camera for view in views})
    as_video = _is_video(arguments.out)
    if as_video and len(rendered_cameras) > 1 and len({(v.width_px, v.height_px) for v in views}) > 1:
        raise UsageError(
            f"cameras {', '.join(rendered_cameras)} have images of different sizes",
            place="--cameras",
            expected="one of them",
        )
    appearances = parse_camera_policies(arguments.appearance, rendered_cameras)
    for words in dict.fromkeys(appearances.values()):
        require_known_appearance(words, dataset, document.trained)
    if arguments.headlights == "off" and not find_capabilities(model.method).has_headlights:
        raise UsageError(
            f"method {name} does not know the vehicle's headlights", place="--headlights", expected="on",
            remedy="train a model with `mirror reconstruct --method hybridworldsim_light`",
        )  # fmt: skip
    policy = AppearancePolicy(views=views, everywhere=True, headlights=arguments.headlights == "on")
    render = open_by_camera(model, policy, appearances, device=device)
    begin = time.perf_counter()
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("rendering", len(views))
        if as_video:
            from mirror.view.video import write_video

            write_video(arguments.out, _side_by_side(views, render, len(rendered_cameras), bar.advance), hz)
            rendered = len(views)
        else:
            inputs = (hash_models(models.values()), *(view.model_dump_json() for view in views), arguments.appearance)
            inputs += ("headlights off",) if arguments.headlights == "off" else ()
            start_render_folder(arguments.out, inputs)
            rendered = _write_images(arguments.out, views, render, bar.advance)
    speed = rendered / (time.perf_counter() - begin)
    if arguments.json:
        counts = {"pictures": len(views), "frames_per_second": speed}
        print(json.dumps({"out": str(arguments.out), "method": name, **counts}))
    else:
        print(f"{len(views)} images by {name}, {speed:.1f} per second: {arguments.out}")
    return ExitCode.DONE


def _base_traversal(dataset: Dataset, trajectory: str, split: str) -> str:
    """The traversal that a trajectory names, or else the first training traversal."""
    if trajectory in dataset.traversals():
        return trajectory
    return dataset.where(split=split, role="train").traversals()[0]


def _side_by_side(
    views: Sequence[RenderView], render: Callable[[RenderView], UInt8], cameras: int, advance: Callable[[int], None]
) -> Iterator[UInt8]:
    import numpy as np

    for start in range(0, len(views), cameras):
        yield np.concatenate([render(view) for view in views[start : start + cameras]], axis=1)
        advance(cameras)


def _write_images(
    out: Path, views: Sequence[RenderView], render: Callable[[RenderView], UInt8], advance: Callable[[int], None]
) -> int:
    """Render the images that do not exist yet, and return their number."""
    from mirror.protocols.png import encode_png
    from mirror.schema.files import write_bytes
    from mirror.schema.render_folder import finish_render_folder

    files = [(view, out / view.camera / f"{view.frame_index:05d}.png") for view in views]
    missing = [(view, file) for view, file in files if not file.is_file()]
    advance(len(files) - len(missing))
    for view, file in missing:
        write_bytes(file, encode_png(render(view)))
        advance(1)
    finish_render_folder(out)
    return len(missing)
