"""The command line of ``mirror depth``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from hybridworldsim.mvs.methods import SPARSE, Method
from hybridworldsim.mvs.options import InitialisationOptions
from mirror.command_line import help_text, parse_arguments
from mirror.devices import choose_device
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror depth demo/block/dataset --split novel",
    "mirror depth demo/block/dataset --split novel --width-px 160 --version small",
)


@dataclass(frozen=True)
class Arguments:
    """Write layers of depth, points and sky masks, which initialise the reconstruction of a split."""

    dataset: tyro.conf.Positional[str]
    """Folder of the dataset."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split. Only its training traversals are read."""
    method: Method = "plane-sweep"
    """Estimator of depth. sparse writes no depth, only points that are matched and triangulated."""
    weights: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """Weights of a learned method."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that estimates; sparse takes none. auto: a GPU that torch can use, else the CPU: the first line says."""
    version: Annotated[str | None, help_text(default="the name of the split")] = None
    """Version of the layers."""
    options: tyro.conf.OmitArgPrefixes[InitialisationOptions] = field(default_factory=InitialisationOptions)


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror depth", examples=_EXAMPLES)

    from hybridworldsim.mvs.run import initialise
    from mirror.dataset.writing import open_to_write
    from mirror.progress import progress_bar

    device = choose_device(arguments.device, f"method {arguments.method}", takes_device=arguments.method != SPARSE)
    print(device, flush=True)
    with progress_bar(quiet=False) as bar:
        report = initialise(
            open_to_write(arguments.dataset),
            arguments.split,
            method=arguments.method,
            weights=arguments.weights,
            version=arguments.version,
            options=arguments.options,
            device=device.name,
            progress=bar,
        )
    points = ", ".join(f"{count} {kind}" for kind, count in report.points.items())
    print(f"layers {report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept")
    if report.written:
        print(f"{report.images} images, {report.known_share:.1%} of static pixels with a depth; points: {points}")
    return ExitCode.DONE
