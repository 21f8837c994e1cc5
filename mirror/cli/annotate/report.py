"""``mirror annotate report``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

_VIDEO_HZ: Final = 4.0
_EXAMPLES: Final = ("mirror annotate report demo/dataset --boxes synth@0.1.0 --out review.html",)


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
    """Another layer of boxes, to compare with; drawn dashed."""
    frames: int = 20
    """Number of frames on the page."""
    video: Annotated[Path | None, help_text(default="none", metavar="FILE.mp4")] = None
    """Also write a video of the boxes from above, of the traversal with the worst frame; --against is drawn in grey."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Write a page for review."""
    arguments = parse_arguments(ReportArguments, argv, "mirror annotate report", examples=_EXAMPLES)
    if arguments.frames < 1:
        raise UsageError(f"{arguments.frames}", place="--frames", expected="1 or more")

    from mirror.annotation.box_layer import choose_box_layer
    from mirror.annotation.familiarity import describe_training_data, read_training_data
    from mirror.annotation.ranking import rank_frames
    from mirror.dataset import open as open_dataset
    from mirror.view.annotation_page import write_annotation_page

    dataset = open_dataset(arguments.dataset)
    layer = choose_box_layer(dataset, arguments.boxes)
    ranks = rank_frames(dataset, layer, arguments.against)
    training = read_training_data(dataset, layer)
    unfamiliar = {(name, stamp) for name, one in training.items() for stamp in one.unfamiliar_ns}
    rows = [
        (
            rank.traversal_id,
            rank.timestamp_ns,
            (
                "unlike the images that the annotator was trained on; "
                if (rank.traversal_id, rank.timestamp_ns) in unfamiliar
                else ""
            )
            + f"{rank.boxes} boxes; {rank.unmatched} boxes without a partner; {rank.breaks} breaks of tracks;"
            f" doubt {rank.unsure:.1f}; largest shift {rank.shift:.1%} of the width",
        )
        for rank in ranks[: arguments.frames]
    ]
    title = f"Boxes of {layer}" + (f" against {arguments.against}" if arguments.against else "")
    view = dataset.with_layers(boxes=layer)
    note = ""
    if training:
        name, frames = layer.partition("@")[0], sum(one.frames for one in training.values())
        note = describe_training_data(name, next(iter(training.values())).trained_on, len(unfamiliar), frames)
    count = write_annotation_page(view, rows, arguments.out, title=title, note=note, against=arguments.against)
    video = str(arguments.video) if arguments.video and ranks else None
    if arguments.video and ranks:
        from mirror.view.birds_eye import draw_from_above
        from mirror.view.video import write_video

        images = draw_from_above(view, ranks[0].traversal_id, arguments.against)
        write_video(arguments.video, images, _VIDEO_HZ)
    if arguments.json:
        worst = asdict(ranks[0]) if ranks else None
        result = {"path": str(arguments.out), "video": video, "layer": layer, "frames": count, "worst": worst,
                  "note": note}  # fmt: skip
        print(json.dumps(result))
    else:
        print(f"{arguments.out}: the worst {count} of {len(ranks)} frames with boxes of {layer}")
        if note:
            print(note)
        if video:
            print(f"{video}: traversal {ranks[0].traversal_id} from above, {_VIDEO_HZ:g} frames a second")
    return ExitCode.DONE
