"""``mirror baseline DATASET --method NAME``: write the submission of a floor, or of another generator's output."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
    from mirror.evaluation.submission.writing import Renderer

_EXAMPLES = (
    "mirror baseline demo/dataset --method nearest_frame --split novel --out floor",
    "mirror baseline demo/block/dataset --method mean_color --split novel --protocol lane-shift --out floor",
)
_FLOORS = ("nearest_frame", "smoothed_nearest_frame", "grey_frame", "camera_mean", "mean_color")
_EDITS = ("unmoved_recording", "erased_vehicle", "flat_patch", "moved_cutout")


@dataclass(frozen=True)
class Arguments:
    """Write the submission of a floor, a baseline that every method must beat, or of a generator's released output.

    nearest_frame submits the recorded image with the nearest camera, smoothed_nearest_frame a blur of it, grey_frame
    its luma in all channels, camera_mean the mean image of the camera, mean_color its mean colour. Where a protocol
    edits vehicles, unmoved_recording submits the recorded image, erased_vehicle that image without the vehicles,
    flat_patch a patch of the vehicle's colour at its target, and moved_cutout, which is no floor, the vehicle's pixels
    there. opendwm, magicdrive-v2 and driveeditor read the images that these programs wrote (--outputs). `mirror
    evaluate` scores the submission.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    method: Annotated[
        Literal[
            "nearest_frame",
            "smoothed_nearest_frame",
            "grey_frame",
            "camera_mean",
            "mean_color",
            "unmoved_recording",
            "erased_vehicle",
            "flat_patch",
            "moved_cutout",
            "opendwm",
            "magicdrive-v2",
            "driveeditor",
        ],
        help_text(metavar="NAME"),
    ]
    """The floor or the generator, one of the names above."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new or empty folder for the submission, or the folder of an interrupted run with the same options."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "static-reconstruction"
    """Name of a protocol, or path of its .toml file."""
    outputs: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """What the generator wrote. With several groups of views, each has a folder of its name in it."""
    clips: Annotated[Path | None, help_text(default="none", metavar="CSV")] = None
    """Places the generator's videos: file,traversal_id,camera,timestamp_ns,hz; the time is that of the first frame."""
    sample: int = 0
    """Number of the sample, of a generator that draws several."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    words = list(argv)
    if words and words[0] in ("nearest_frame", "mean_color"):
        print(f"mirror baseline: the floor is now an option: --method {words[0]}", file=sys.stderr)
        words = [*words[1:], "--method", words[0]]
    arguments = parse_arguments(Arguments, words, "mirror baseline", examples=_EXAMPLES)

    import mirror
    from mirror.evaluation.submission.writing import write_submission
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views
    from mirror.version import __version__

    renderer, method, appearance, inputs = _choose_method(arguments)
    dataset = mirror.open(arguments.dataset)
    plan = plan_views(dataset, load_protocol(arguments.protocol), arguments.split)
    with progress_bar(quiet=False) as bar:
        of = f"{__version__} {inputs}".strip()
        count = write_submission(dataset, plan, renderer, method, appearance, arguments.out, bar, of=of)
    print(f"{count} renders: {arguments.out}")
    return ExitCode.DONE


def _choose_method(arguments: Arguments) -> tuple[Renderer, SubmittedMethod, Appearance, str]:
    """Return the renderer, what the manifest states of it, and a hash of what it reads besides the dataset."""
    if arguments.method in (*_FLOORS, *_EDITS):
        for option, given in (("--outputs", arguments.outputs), ("--clips", arguments.clips)):
            if given is not None:
                raise UsageError(
                    f"{arguments.method} reads no output of another program",
                    place=option,
                    expected=f"--method {' or '.join(_takers(option))}",
                )
        if arguments.method in _EDITS:
            from mirror_baselines.edited_recordings import APPEARANCE, EDITED_RECORDINGS

            edited = EDITED_RECORDINGS[arguments.method]
            return edited.render, edited.method, APPEARANCE, ""
        floor = import_module(f"mirror_baselines.{arguments.method}")
        return floor.render, floor.METHOD, floor.APPEARANCE, ""

    from mirror_baselines.released.files import ReleasedFiles
    from mirror_baselines.released.generators import APPEARANCE, GENERATORS
    from mirror_baselines.released.submission import make_renderer

    generator = GENERATORS[arguments.method]
    if arguments.outputs is None or not arguments.outputs.is_dir():
        raise UsageError(
            "missing" if arguments.outputs is None else "no such folder",
            file=arguments.outputs,
            place="--outputs",
            expected=f"the folder that {generator.method.name} wrote",
        )
    if generator.image_name is None and arguments.clips is None:
        raise UsageError(
            f"{generator.method.name} writes videos without a name of what they show",
            place="--clips",
            expected="a table that places them in the dataset",
        )
    if arguments.clips is not None and not generator.videos:
        raise UsageError(f"no videos of {generator.method.name} are read", place="--clips", expected="no such option")
    files = ReleasedFiles(generator, arguments.outputs, arguments.clips, arguments.sample)
    return make_renderer(files), generator.method, APPEARANCE, files.hash


def _takers(option: str) -> list[str]:
    """The methods that take ``--outputs`` or ``--clips``."""
    from mirror_baselines.released.generators import GENERATORS

    return [name for name, generator in GENERATORS.items() if option == "--outputs" or generator.videos]
