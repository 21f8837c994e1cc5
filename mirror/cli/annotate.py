"""``mirror annotate DATASET --annotator NAME``, and its subcommands."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from mirror.annotation.tracking.options import TrackingOptions
from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.annotation.run import AnnotationReport

_MOST_SHOWN: Final = 5
_CORE_MINUTES: Final = 3.0
_VIDEO_HZ: Final = 4.0
_EXAMPLES = (
    "mirror annotate demo/dataset --annotator file --set path=results.json",
    "mirror annotate demo/dataset --annotator subprocess --set command='python detect.py' --set limit_s=20",
)
_TRACK_EXAMPLES = ("mirror annotate track demo/dataset --boxes synth@0.1.0",)
_MASK_EXAMPLES = ("mirror annotate masks demo/dataset --boxes synth@0.1.0",)
_REPORT_EXAMPLES = ("mirror annotate report demo/dataset --boxes synth@0.1.0 --out review.html",)
_TRAIN_EXAMPLES = (
    "mirror annotate train demo/dataset --annotator petr-tiny --minutes 3 --out detector",
    "mirror annotate train streets/1 streets/2 --annotator petr-tiny --steps 2000 --threads 1 --out detector",
)
_DESCRIBE_EXAMPLES = (
    "mirror annotate describe demo/dataset --out descriptions.jsonl",
    "mirror annotate describe demo/dataset --describer subprocess --set command='python caption.py' --out captions",
)
_EXPORT_EXAMPLES = ("mirror annotate export demo/dataset --boxes synth@0.1.0 --out review.json",)


@dataclass(frozen=True)
class Arguments:
    """Find the road users in all frames of a dataset, and write a layer of boxes for each traversal.

    `mirror annotate train` trains an annotator, `mirror annotate track` makes tracks of a layer of boxes, `mirror
    annotate masks` writes masks of its road users, `mirror annotate export` writes it as a file, and `mirror annotate
    describe` writes captions. Layers lie side by side and are never replaced. Finished frames are kept when the run is
    interrupted or a frame fails: the same command continues there.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    annotator: Annotated[str, help_text(metavar="NAME")]
    """An installed annotator (entry points mirror.annotators): file reads results of the nuScenes format, subprocess
    runs a program of yours."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the annotator, such as path=results.json."""
    source: Annotated[str | None, help_text(default="the annotator's name", metavar="NAME")] = None
    """Source name of the layers."""
    version: Annotated[str | None, help_text(default="the annotator's version", metavar="NAME")] = None
    """Version of the layers."""
    scene: Annotated[str | None, help_text(default="all", metavar="ID")] = None
    """Annotate this scene only."""
    skip_failed: bool = False
    """Write the layer of a traversal although frames failed; they have no boxes then."""
    device: str = "cpu"
    """Device of networks: cpu or cuda."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class TrainArguments:
    """Train an annotator on the boxes of datasets.

    Ctrl-C leaves a checkpoint, and the same command continues from it. A finished model is reported and not changed.
    """

    datasets: Annotated[tyro.conf.Positional[tuple[str, ...]], help_text(default="none", metavar="DATASET")]
    """Folders or URLs of one or more datasets with boxes."""
    annotator: Annotated[str, help_text(metavar="NAME")]
    """An installed annotator that can be trained (entry points mirror.annotators), such as petr-tiny."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """Folder of the run: a new one, or that of an interrupted run with the same options."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes that is learned."""
    minutes: Annotated[float | None, help_text(default=f"{_CORE_MINUTES:g}, unless --steps is given")] = None
    """Processor time of training in minutes, summed over threads. Excludes --steps."""
    steps: Annotated[int | None, help_text(default="none")] = None
    """Number of steps. Repeats exactly with the same --threads. Excludes --minutes."""
    split: Annotated[str | None, help_text(default="all traversals", metavar="NAME")] = None
    """Train on the training traversals of this split alone."""
    seed: int = 0
    """Seed of all random choices."""
    threads: int = 1
    """Number of threads."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the training, such as learning_rate=0.0005; run.json has all."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class TrackArguments:
    """Make tracks of a layer of boxes: ids, smooth positions, velocities and one size for each object.

    The tracks of SOURCE@VERSION become the layer SOURCE-tracks@VERSION. Stationary objects are merged across the
    traversals of a scene.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    version: Annotated[str | None, help_text(default="that of the boxes", metavar="NAME")] = None
    """Version of the layer of tracks."""
    options: tyro.conf.OmitArgPrefixes[TrackingOptions] = field(default_factory=TrackingOptions)
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class MaskArguments:
    """Write masks of road users for reconstruction and scoring: instance masks where given, else hulls of boxes.

    The masks of SOURCE@VERSION become the layer SOURCE-hulls@VERSION, of kind dynamic, which the static reconstruction
    and the protocols leave out. Parked vehicles are masked too; barriers and cones are not.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    version: Annotated[str | None, help_text(default="that of the boxes", metavar="NAME")] = None
    """Version of the layer of masks."""
    margin: float = 0.1
    """Growth of each box's length, width and height, as a share."""
    min_score: float = 0.3
    """Boxes with a lower score are left out; labels without a score count."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class ReportArguments:
    """Write a page for review: images with their boxes, the worst frames first.

    Frames come first where the boxes of two layers disagree, in space or in the images, and where tracks break within
    25 m, then where scores are low.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FILE")]
    """The page (HTML), which holds its images itself; it is replaced if it exists."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes that is drawn."""
    against: Annotated[str | None, help_text(default="none", metavar="SOURCE@VERSION")] = None
    """Another layer of boxes, to compare with."""
    frames: int = 20
    """Number of frames on the page."""
    video: Annotated[Path | None, help_text(default="none", metavar="FILE.mp4")] = None
    """Also write a video of the boxes from above, of the traversal with the worst frame; --against is drawn in grey."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class DescribeArguments:
    """Describe the frames of a dataset: a caption, the light and the weather, one line of JSON each.

    Finished frames are kept when the run is interrupted or a frame fails: the same command continues there.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FILE")]
    """The file (JSON lines): a new one, or that of an interrupted run."""
    describer: Annotated[str, help_text(metavar="NAME")] = "recorded"
    """An installed describer (entry points mirror.describers): recorded says what the sun and the recording say,
    subprocess runs a program of yours."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the describer, such as command='python caption.py'."""
    scene: Annotated[str | None, help_text(default="all", metavar="ID")] = None
    """Describe this scene only."""
    device: str = "cpu"
    """Device of networks: cpu or cuda."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class ExportArguments:
    """Write a layer of boxes as results of the nuScenes detection task (JSON), for review in another tool.

    `mirror annotate DATASET --annotator file --set path=FILE` imports what comes back as a layer of its own.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FILE")]
    """The file; it is replaced if it exists."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb, or one of its subcommands."""
    if argv and argv[0] in _SUBCOMMANDS:
        return run_subcommand(argv, "mirror annotate", _SUBCOMMANDS)
    arguments = parse_arguments(Arguments, argv, "mirror annotate", examples=_EXAMPLES)

    from mirror.annotation.registry import installed_annotator

    installed = installed_annotator(arguments.annotator)

    import mirror
    from mirror.annotation.run import annotate
    from mirror.progress import progress_bar

    dataset = mirror.open(arguments.dataset)
    if arguments.scene is not None:
        dataset = dataset.where(scene=arguments.scene)
    annotator = installed.open(dataset, _settings(arguments.set), arguments.device)
    try:
        with progress_bar(quiet=arguments.json) as bar:
            report = annotate(
                dataset,
                annotator,
                source=arguments.source,
                version=arguments.version,
                skip_failed=arguments.skip_failed,
                progress=bar,
            )
    finally:
        annotator.close()
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
    else:
        _print(report, arguments)
    return ExitCode.PARTLY_DONE if report.failed else ExitCode.DONE


def _print(report: AnnotationReport, arguments: Arguments) -> None:
    print(
        f"layer boxes/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept; "
        f"{report.boxes} boxes in {report.frames + report.resumed} frames ({report.resumed} from an earlier run)"
    )
    if report.failed:
        print(
            f"{len(report.failed)} frames failed; traversals without a layer: {', '.join(report.incomplete) or 'none'}"
        )
        for failed in report.failed[:_MOST_SHOWN]:
            print(f"  {failed.traversal_id}, frame {failed.frame_index}: {failed.reason}")
        if report.incomplete:
            print("run the same command again for the failed frames, or write the layers without them: --skip-failed")
    elif report.written:
        print(f"next: mirror annotate track {arguments.dataset} --boxes {report.layer}")


def _train(argv: Sequence[str]) -> int:
    arguments = parse_arguments(TrainArguments, argv, "mirror annotate train", examples=_TRAIN_EXAMPLES)
    for name, number in (
        ("--minutes", arguments.minutes),
        ("--steps", arguments.steps),
        ("--threads", arguments.threads),
    ):
        if number is not None and not number > 0:
            raise UsageError(f"{number:g}", place=name, expected="more than 0")
    if arguments.seed < 0:
        raise UsageError(f"{arguments.seed}", place="--seed", expected="0 or more")
    if arguments.minutes is not None and arguments.steps is not None:
        raise UsageError("--minutes and --steps exclude each other", expected="one of them, or neither")
    if not arguments.datasets:
        raise UsageError("no dataset", place="DATASETS", expected="one or more datasets with boxes")

    from mirror.annotation.protocol import TrainableAnnotator, TrainingTask
    from mirror.annotation.registry import annotator_names, installed_annotator

    annotator = installed_annotator(arguments.annotator)
    if not isinstance(annotator, TrainableAnnotator):
        names = ", ".join(annotator_names())
        raise UsageError(
            f"annotator {arguments.annotator!r} cannot be trained", place="--annotator",
            expected=f"one that has a training, of {names}",
        )  # fmt: skip

    import mirror
    from mirror.annotation.box_layer import choose_box_layer
    from mirror.progress import progress_bar

    views = []
    for path in arguments.datasets:
        dataset = mirror.open(path)
        if arguments.split is not None:
            dataset = dataset.where(split=arguments.split, role="train")
        views.append(dataset.with_layers(boxes=choose_box_layer(dataset, arguments.boxes)))
    minutes = _CORE_MINUTES if arguments.minutes is None and arguments.steps is None else arguments.minutes
    task = TrainingTask(arguments.steps, minutes, arguments.seed, arguments.threads, _settings(arguments.set))
    with progress_bar(quiet=arguments.json) as bar:
        report = annotator.train(views, task, arguments.out, bar)
    if arguments.json:
        print(json.dumps(asdict(report)))
        return ExitCode.DONE
    print(
        f"{report.steps} steps on {report.frames} frames with {report.boxes} boxes, {report.core_s / 60.0:.1f} "
        f"core-minutes, {report.wall_s / 60.0:.1f} minutes; loss {report.loss:.3f}"
    )
    print(f"model: {report.model}, {report.model_bytes / 1e6:.2f} MB, sha256 {report.sha256}")
    print(f"next: mirror annotate DATASET --annotator {arguments.annotator} --set weights={report.model}")
    return ExitCode.DONE


def _track(argv: Sequence[str]) -> int:
    arguments = parse_arguments(TrackArguments, argv, "mirror annotate track", examples=_TRACK_EXAMPLES)

    import mirror
    from mirror.annotation.tracking.layer import track_layer
    from mirror.progress import progress_bar

    with progress_bar(quiet=arguments.json) as bar:
        report = track_layer(
            mirror.open(arguments.dataset), arguments.boxes, arguments.options, version=arguments.version, progress=bar
        )
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
        return ExitCode.DONE
    print(f"layer boxes/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept")
    if report.written:
        print(
            f"{report.detections} boxes became {report.tracks} tracks ({report.stationary} stationary)"
            f" with {report.boxes} boxes"
        )
    if report.detections and not report.tracks:
        options = arguments.options
        print(
            f"a track has at least {options.min_boxes} boxes (--min-boxes), at most {options.max_gap_s:g} s apart"
            " (--max-gap-s): are the frames farther apart?"
        )
    return ExitCode.DONE


def _masks(argv: Sequence[str]) -> int:
    arguments = parse_arguments(MaskArguments, argv, "mirror annotate masks", examples=_MASK_EXAMPLES)

    import mirror
    from mirror.annotation.masks import MaskOptions, mask_layer
    from mirror.progress import progress_bar

    options = MaskOptions(arguments.margin, arguments.min_score)
    with progress_bar(quiet=arguments.json) as bar:
        report = mask_layer(
            mirror.open(arguments.dataset), arguments.boxes, options, version=arguments.version, progress=bar
        )
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
        return ExitCode.DONE
    print(f"layer masks/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept")
    if report.written:
        print(f"{report.images} masks; road users cover {report.share:.1%} of the pixels")
    return ExitCode.DONE


def _report(argv: Sequence[str]) -> int:
    arguments = parse_arguments(ReportArguments, argv, "mirror annotate report", examples=_REPORT_EXAMPLES)
    if arguments.frames < 1:
        raise UsageError(f"{arguments.frames}", place="--frames", expected="1 or more")

    import mirror
    from mirror.annotation.box_layer import choose_box_layer
    from mirror.annotation.ranking import rank_frames
    from mirror.view.annotation_page import write_annotation_page

    dataset = mirror.open(arguments.dataset)
    layer = choose_box_layer(dataset, arguments.boxes)
    ranks = rank_frames(dataset, layer, arguments.against)
    rows = [
        (
            rank.traversal_id,
            rank.timestamp_ns,
            f"{rank.boxes} boxes; {rank.unmatched} boxes without a partner; {rank.breaks} breaks of tracks;"
            f" doubt {rank.unsure:.1f}; largest shift {rank.shift:.1%} of the width",
        )
        for rank in ranks[: arguments.frames]
    ]
    title = f"Boxes of {layer}" + (f" against {arguments.against}" if arguments.against else "")
    view = dataset.with_layers(boxes=layer)
    count = write_annotation_page(view, rows, arguments.out, title=title)
    video = str(arguments.video) if arguments.video and ranks else None
    if arguments.video and ranks:
        from mirror.view.birds_eye import draw_from_above
        from mirror.view.video import write_video

        images = draw_from_above(view, ranks[0].traversal_id, arguments.against)
        write_video(arguments.video, images, _VIDEO_HZ)
    if arguments.json:
        worst = asdict(ranks[0]) if ranks else None
        result = {"path": str(arguments.out), "video": video, "layer": layer, "frames": count, "worst": worst}
        print(json.dumps(result))
    else:
        print(f"{arguments.out}: the worst {count} of {len(ranks)} frames with boxes of {layer}")
        if video:
            print(f"{video}: traversal {ranks[0].traversal_id} from above, {_VIDEO_HZ:g} frames a second")
    return ExitCode.DONE


def _describe(argv: Sequence[str]) -> int:
    arguments = parse_arguments(DescribeArguments, argv, "mirror annotate describe", examples=_DESCRIBE_EXAMPLES)

    import mirror
    from mirror.annotation.descriptions import describe_frames, installed_describer
    from mirror.progress import progress_bar

    installed = installed_describer(arguments.describer)
    dataset = mirror.open(arguments.dataset)
    if arguments.scene is not None:
        dataset = dataset.where(scene=arguments.scene)
    describer = installed.open(dataset, _settings(arguments.set), arguments.device)
    try:
        with progress_bar(quiet=arguments.json) as bar:
            report = describe_frames(dataset, describer, arguments.out, bar)
    finally:
        describer.close()
    if arguments.json:
        print(json.dumps({"dataset": arguments.dataset, **asdict(report)}))
    else:
        print(f"{report.path}: {report.frames} frames described, {report.kept} kept, {len(report.failed)} failed")
    return ExitCode.PARTLY_DONE if report.failed else ExitCode.DONE


def _export(argv: Sequence[str]) -> int:
    arguments = parse_arguments(ExportArguments, argv, "mirror annotate export", examples=_EXPORT_EXAMPLES)

    import mirror
    from mirror.annotation.review import export_results

    report = export_results(mirror.open(arguments.dataset), arguments.out, arguments.boxes)
    if arguments.json:
        print(json.dumps(asdict(report)))
    else:
        print(f"{report.path}: {report.boxes} boxes of layer {report.layer} in {report.samples} samples")
    return ExitCode.DONE


def _settings(words: Sequence[str]) -> dict[str, str]:
    invalid = [word for word in words if not all(word.partition("="))]
    if invalid:
        raise UsageError(f"{invalid[0]!r}", place="--set", expected="NAME=VALUE")
    return {name: value for name, _, value in (word.partition("=") for word in words)}


_SUBCOMMANDS: Final = {
    "train": Subcommand("train an annotator on the boxes of datasets", _train),
    "track": Subcommand("make tracks of a layer of boxes", _track),
    "masks": Subcommand("write masks of road users from a layer of boxes", _masks),
    "report": Subcommand("write a page of the frames to review, the worst first", _report),
    "describe": Subcommand("describe frames: captions, light and weather", _describe),
    "export": Subcommand("write a layer of boxes as nuScenes results, for review", _export),
}
