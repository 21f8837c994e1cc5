"""Makes the clips of a dataset into a folder; ``clips.json`` comes last, and an interrupted run continues."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from hybridworldsim.generation.clips.folder import LIST, ClipList, write_list
from hybridworldsim.generation.clips.weights import RULE
from hybridworldsim.generation.devices import require_counts
from hybridworldsim.generation.network.configuration import SMALL
from hybridworldsim.generation.recorded.documents import ClipStatistics, TraversalClips, join_counts, join_numbers
from hybridworldsim.generation.recorded.sheet import write_sheet
from hybridworldsim.generation.recorded.sources import ClipSources, find_sources
from hybridworldsim.generation.recorded.traversal_clips import ClipMaker, ClipSettings, traversal_file
from hybridworldsim.generation.recorded.windows import TraversalWindows, WindowOptions, plan_windows, require_bounds
from hybridworldsim.generation.scenes.rollout import require_size
from mirror.dataset.dataset import Dataset
from mirror.devices import CPU, hardware_name
from mirror.errors import DatasetError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.executors.job import Failure, ParallelJob
from mirror.progress import ProgressReporter
from mirror.schema.files import read_json, write_json
from mirror.schema.folders import FolderKind
from mirror.schema.render_folder import finish_render_folder, start_render_folder

STATISTICS: Final = "statistics.json"


@dataclass(frozen=True)
class ClipRequest:
    """The request to make clips of a dataset.

    Attributes:
        backgrounds: see `find_sources`.
        split: name of the split; None: that of the model.
        role: role of the traversals; only ``train`` is taken.
        boxes: layer of boxes; None: the only one.
        cameras: names; None: those of the first traversal.
        size_px: height and width of images.
        windows: see `WindowOptions`.
        least_share: see `ClipSettings`.
        least_busy: see `ClipSettings`.
        min_score: see `ClipSettings`.
        method: ``FILE.py:OBJECT`` of the models' method; None: it is installed.
        workers: number of processes.
        executor: where the clips of a traversal are made; None: in this process, or in processes if there are several.
        device: where static models render, as torch names it.
    """

    backgrounds: tuple[str, ...]
    split: str | None = None
    role: str = "train"
    boxes: str | None = None
    cameras: tuple[str, ...] | None = None
    size_px: tuple[int, int] = (64, 96)
    windows: WindowOptions = field(default_factory=WindowOptions)
    least_share: float = 0.01
    least_busy: float = 0.3
    min_score: float = 0.3
    method: str | None = None
    workers: int = 1
    device: str = CPU
    executor: ExecutorChoice | None = None

    def __post_init__(self) -> None:
        require_counts(workers=self.workers)
        if not self.backgrounds:
            raise UsageError("no static street", place="--background", expected="a model of `mirror reconstruct`")
        for name, place in (("least_share", "--min-share"), ("least_busy", "--min-busy"), ("min_score", "--min-score")):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UsageError(f"{getattr(self, name)}", place=place, expected="a share from 0 to 1")


def make_recorded_clips(
    dataset: Dataset, request: ClipRequest, out: Path, progress: ProgressReporter
) -> ClipStatistics:
    """Make the clips of the training traversals of a dataset.

    The clips do not depend on the number of workers.

    Args:
        dataset: the dataset.
        request: what is made.
        out: a new or an empty folder, or that of an interrupted call with the same request.
        progress: receives the number of windows and each finished one.

    Raises:
        UsageError: the request does not fit the dataset, something is missing, or the folder holds other files.
        DatasetError: an image, a mask or a model is missing or broken, no window shows a road user, or a worker died.
    """
    require_size(SMALL, request.size_px, "choose whole tokens")
    sources = find_sources(
        dataset, request.backgrounds, split=request.split, role=request.role, boxes=request.boxes, method=request.method
    )
    cameras = _choose_cameras(dataset, sources, request.cameras)
    planned = [plan_windows(dataset, name, cameras, request.windows) for name in sources.traversals]
    require_bounds(planned, request.windows)
    settings = ClipSettings(
        cameras, request.size_px, request.windows.frames, request.least_share, request.least_busy, request.min_score,
        request.method,
    )  # fmt: skip
    inputs = _inputs(dataset, request, sources, settings)
    start_render_folder(
        out, [f"{name}={value}" for name, value in sorted(inputs.items())], last=LIST, kind=FolderKind.CLIPS
    )
    maker = ClipMaker(str(dataset.root), dataset.layers.poses, sources, settings, out, request.device)
    done: dict[str, TraversalClips] = {}
    progress.start("windows", sum(len(one.firsts) for one in planned))
    for one in planned:
        file = traversal_file(out, one.traversal_id)
        if file.is_file():
            done[one.traversal_id] = read_json(file, TraversalClips)
            progress.advance(len(one.firsts))
    for document in _make_all(maker, [one for one in planned if one.traversal_id not in done], request, progress):
        done[document.traversal] = document
    documents = [done[name] for name in sources.traversals]
    clips = tuple(clip for one in documents for clip in one.clips)
    if not clips:
        raise DatasetError(
            f"none of {sum(one.quiet for one in documents)} windows shows road users", file=dataset.root,
            place=f"boxes {sources.boxes}", expected=f"one that covers {request.least_share:.1%} of a view",
            remedy="lower --min-share or --min-busy, and name a new folder with --out",
        )  # fmt: skip
    statistics = _statistics(documents, inputs)
    write_json(out / STATISTICS, statistics)
    write_sheet(out, clips)
    traversals = f"{statistics.traversals} traversals of split {sources.split}"
    write_list(out, ClipList(source=f"{dataset.root}, {traversals}, boxes {sources.boxes}", training=clips, test=()))
    finish_render_folder(out, FolderKind.CLIPS)
    return statistics


def _make_all(
    maker: ClipMaker, planned: Sequence[TraversalWindows], request: ClipRequest, progress: ProgressReporter
) -> Iterator[TraversalClips]:
    is_alone = request.workers == 1 or len(planned) < 2
    choice = request.executor or ExecutorChoice("serial" if is_alone else "processes", request.workers)
    if choice.kind == "ray":
        # Workers of a cluster have other current folders.
        maker = replace(maker, root=str(Path(maker.root).absolute()), out=maker.out.absolute())
    with choice.open() as executor:
        # In this process each window is counted, elsewhere all of a traversal when it is done.
        advance = progress.advance if executor.is_local else _count_nothing
        for number, answer in executor.map(ParallelJob(_make_clipping, (maker, advance)), planned):
            if isinstance(answer, Failure):
                answer.raise_error(
                    place=planned[number].traversal_id,
                    remedy="run the same command again: it continues. If memory ran out, --workers 1 needs the least",
                )
            if not executor.is_local:
                progress.advance(len(planned[number].firsts))
            yield answer


def _make_clipping(maker: ClipMaker, advance: Callable[[int], None]) -> Callable[[TraversalWindows], TraversalClips]:
    return partial(maker.make, advance=advance)


def _count_nothing(steps: int) -> None:
    """Count the windows of a traversal where nobody sees them."""


def _choose_cameras(dataset: Dataset, sources: ClipSources, cameras: tuple[str, ...] | None) -> tuple[str, ...]:
    """The cameras of the clips: all traversals must have them.

    Raises:
        UsageError: a traversal lacks one, or one is named twice.
    """
    view = dataset.where(traversal=list(sources.traversals))
    table = view.table("images", ["traversal_id", "camera"])
    own: dict[str, dict[str, None]] = {name: {} for name in sources.traversals}
    for batch in table.to_batches():
        columns = [batch.column(name).dictionary_encode() for name in ("traversal_id", "camera")]
        pairs = set(zip(*(one.indices.to_pylist() for one in columns)))
        names = [one.dictionary.to_pylist() for one in columns]
        for traversal, camera in sorted(pairs):
            own[names[0][traversal]][names[1][camera]] = None
    first = sources.traversals[0]
    wanted = cameras or tuple(view.where(traversal=first).frames()[0].images)
    if len(set(wanted)) < len(wanted):
        raise UsageError(", ".join(wanted), place="--cameras", expected="each camera once")
    for name, having in own.items():
        lacking = [camera for camera in wanted if camera not in having]
        if lacking:
            raise UsageError(
                f"traversal {name} has no camera {', '.join(lacking)}", place="--cameras",
                expected=f"cameras that all traversals have: {', '.join(_common(own)) or 'there is none'}",
                remedy="name such with --cameras, or make clips of a split whose traversals are of one rig",
            )  # fmt: skip
    return wanted


def _common(own: dict[str, dict[str, None]]) -> list[str]:
    return sorted(set.intersection(*(set(one) for one in own.values())))


def _inputs(dataset: Dataset, request: ClipRequest, sources: ClipSources, settings: ClipSettings) -> dict[str, Any]:
    return {
        "dataset": dataset.index_sha256,
        "split": sources.split,
        "boxes": sources.boxes,
        "poses": dataset.layers.poses,
        "backgrounds": {scene: street.identity for scene, street in sorted(sources.streets.items())},
        "windows": asdict(request.windows),
        **asdict(settings),
        # Images of a GPU differ in the last digits; clips of the CPU keep their documents.
        **({} if request.device == CPU else {"device": hardware_name(request.device)}),
    }


def _statistics(documents: Sequence[TraversalClips], inputs: dict[str, Any]) -> ClipStatistics:
    return ClipStatistics(
        traversals=sum(bool(one.clips) for one in documents),
        candidates=sum(one.candidates for one in documents),
        standing=sum(one.standing for one in documents),
        lacking=sum(one.lacking for one in documents),
        quiet=sum(one.quiet for one in documents),
        unknown_boxes=join_numbers([one.unknown_boxes for one in documents]),
        counts=join_counts([one.counts for one in documents]),
        weights=RULE,
        inputs=inputs,
    )
