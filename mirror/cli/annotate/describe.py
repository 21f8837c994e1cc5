"""``mirror annotate describe``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments, parse_settings
from mirror.devices import choose_device
from mirror.errors import ExitCode

_EXAMPLES: Final = (
    "mirror annotate describe demo/dataset --out descriptions.jsonl",
    "mirror annotate describe demo/dataset --describer subprocess --set command='python caption.py' --out captions",
)


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
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that runs networks. auto: a GPU that torch can use, else the CPU. The first line says which."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Describe frames."""
    arguments = parse_arguments(DescribeArguments, argv, "mirror annotate describe", examples=_EXAMPLES)

    from mirror.annotation.descriptions import describe_frames, installed_describer
    from mirror.annotation.protocol import takes_device
    from mirror.dataset import open as open_dataset
    from mirror.progress import progress_bar

    installed = installed_describer(arguments.describer)
    device = choose_device(arguments.device, f"describer {arguments.describer}", takes_device=takes_device(installed))
    if not arguments.json:
        print(device, flush=True)
    dataset = open_dataset(arguments.dataset)
    if arguments.scene is not None:
        dataset = dataset.where(scene=arguments.scene)
    describer = installed.open(dataset, parse_settings(arguments.set), device.name)
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
