"""``mirror generate clips``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode
from mirror.executors.arguments import ExecutorArguments

if TYPE_CHECKING:
    from hybridworldsim.generation.recorded.documents import ClipStatistics

_EXAMPLES = (
    "mirror generate clips demo/block/dataset --background demo/block/model --out clips",
    "mirror generate clips dataset --background model_a --background model_b --boxes petr@2 --workers 4 --out clips",
)


@dataclass(frozen=True)
class ClipArguments:
    """Make clips of a dataset's recordings, to train a generator on.

    A clip is a window of consecutive frames in which the vehicle moves and road users are seen. It has the recorded
    images, the same views of the static street, boxes, masks, cameras and the recorded map. Only training traversals
    are read. The same command continues an interrupted run.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset: images, poses, lenses, boxes, and masks of `mirror annotate masks`."""
    background: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="MODEL|exact:PRESET[:SEED]")]
    """The static street: a model that `mirror reconstruct` wrote, once for each scene; or the exact synthetic
    street."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or that of an interrupted run with the same options."""
    split: Annotated[str | None, help_text(default="that of the model", metavar="NAME")] = None
    """Split whose training traversals are used."""
    role: str = "train"
    """Role of the traversals in the split. Held-out ones are refused."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes: labels of people, or of a version of an annotator."""
    cameras: Annotated[str | None, help_text(default="those of the first traversal", metavar="NAMES")] = None
    """Cameras, separated by commas. All traversals must have them."""
    size: Annotated[str, help_text(metavar="WIDTHxHEIGHT")] = "96x64"
    """Pixels of the clips' images."""
    hz: Annotated[float | None, help_text(default="5, or the recording's rate if it is lower")] = None
    """Frames per second."""
    frames: int = 26
    """Frames of a clip."""
    min_move: float = 3.0
    """Metres that the vehicle drives at least in a clip."""
    min_share: float = 0.01
    """A frame shows a road user where one covers this share of some view."""
    min_busy: float = 0.3
    """Share of the frames of a clip that show a road user at least."""
    min_score: float = 0.3
    """Boxes with a lower score are left out; labels without a score count."""
    may_lack: Annotated[float | None, help_text(default="nothing may be missing", metavar="SHARE")] = None
    """Largest share of the images of a clip that may be missing or without a mask. Where something is missing, it must
    be given."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """Method of the static model."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that renders static models. auto: a GPU that torch and gsplat can use, else the CPU. The first line says
    which."""
    workers: int = 1
    """Number of processes, which share the traversals. Clips do not depend on it."""
    executor: tyro.conf.OmitArgPrefixes[ExecutorArguments] = field(default_factory=ExecutorArguments)
    json: bool = False
    """Print JSON."""


def run_clips(argv: Sequence[str]) -> int:
    """Make clips of a dataset's recordings."""
    arguments = parse_arguments(ClipArguments, argv, "mirror generate clips", examples=_EXAMPLES)

    import mirror
    from hybridworldsim.generation.commands.scene import parse_size
    from hybridworldsim.generation.recorded.run import ClipRequest, make_recorded_clips
    from hybridworldsim.generation.recorded.windows import WindowOptions
    from hybridworldsim.generation.scenes.backgrounds import choose_background_device
    from mirror.progress import progress_bar

    device = choose_background_device(arguments.background, arguments.device, arguments.method)
    if not arguments.json:
        print(device, flush=True)
    request = ClipRequest(
        arguments.background,
        split=arguments.split,
        role=arguments.role,
        boxes=arguments.boxes,
        cameras=None if arguments.cameras is None else tuple(arguments.cameras.split(",")),
        size_px=parse_size(arguments.size),
        windows=WindowOptions(arguments.frames, arguments.hz, arguments.min_move, arguments.may_lack),
        least_share=arguments.min_share,
        least_busy=arguments.min_busy,
        min_score=arguments.min_score,
        method=arguments.method,
        workers=arguments.workers,
        device=device.name,
        executor=None
        if arguments.executor == ExecutorArguments()
        else arguments.executor.choose("serial" if arguments.workers == 1 else "processes", arguments.workers),
    )
    with progress_bar(quiet=arguments.json) as bar:
        statistics = make_recorded_clips(mirror.open(arguments.dataset), request, arguments.out, bar)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **statistics.model_dump()}))
        return ExitCode.DONE
    for line in describe_clips(statistics):
        print(line)
    print(f"sheet: {arguments.out / 'sheet.png'}")
    print(f"next: mirror generate train {arguments.out} --steps 4000 --out GENERATOR")
    return ExitCode.DONE


def describe_clips(statistics: ClipStatistics) -> Iterator[str]:
    """Yield the lines that describe clips: windows, hours, road users by class and size, errors of backgrounds."""
    counts, error = statistics.counts, statistics.counts.error
    yield (
        f"{counts.windows} windows of {statistics.traversals} traversals, {counts.frames} frames,"
        f" {counts.seconds / 3600.0:.3f} hours"
    )
    yield (
        f"left out of {statistics.candidates} windows: {statistics.standing} stand, {statistics.lacking} lack images or"
        f" masks, {statistics.quiet} show too few road users"
    )
    for name, tracks in counts.tracks.items():
        sizes = ", ".join(f"{count} {size}" for size, count in counts.shown.get(name, {}).items())
        yield f"{name}: {tracks} road users; in views, by share of the view: {sizes}"
    for name, boxes in statistics.unknown_boxes.items():
        yield f"{name}: {boxes} boxes; the generator has no such class, and their pixels are not trained on"
    yield f"pixels: {counts.masked:.1%} of road users, {counts.excluded:.1%} not trained on"
    yield f"background against images outside the masks: {error.psnr_db:.1f} dB"
    for name, one in counts.errors.items():
        if one.pixels:
            share = one.pixels / error.pixels
            yield f"  places that road users hide in {name} of the training images: {one.psnr_db:.1f} dB, {share:.1%}"
    yield f"weight of a pixel in training: {statistics.weights}"
