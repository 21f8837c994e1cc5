"""The command line of ``mirror depth``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hybridworldsim.mvs.methods import Method
from hybridworldsim.mvs.options import InitialisationOptions
from mirror.command_line import parse_arguments
from mirror.errors import ExitCode


@dataclass(frozen=True)
class Arguments:
    """Write the layers of depth, points and sky masks that initialise the reconstruction of a split."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder."""
    split: str
    """Name of the split; the command reads its training traversals only."""
    method: Method = "plane-sweep"
    """Depth estimator. sparse: no depth; features are matched and triangulated to points."""
    weights: Path | None = None
    """File with the weights of a learned method."""
    version: str | None = None
    """Version of the layers; default: the name of the split."""
    options: tyro.conf.OmitArgPrefixes[InitialisationOptions] = field(default_factory=InitialisationOptions)


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror depth")
    """Run ``mirror depth``; return the exit code."""
    arguments = parse_arguments(Arguments, argv, "mirror depth")

    import mirror
    from hybridworldsim.mvs.run import initialise
    from mirror.progress import progress_bar

    with progress_bar(quiet=False) as bar:
        report = initialise(
            mirror.open(arguments.dataset),
            arguments.split,
            method=arguments.method,
            weights=arguments.weights,
            version=arguments.version,
            options=arguments.options,
            progress=bar,
        )
    points = ", ".join(f"{count} {kind}" for kind, count in report.points.items())
    print(f"layers {report.layer}: {len(report.written)} traversals written, {len(report.kept)} already complete")
    if report.written:
        print(f"{report.images} images, {report.known_share:.1%} of static pixels with a depth; points: {points}")
    return ExitCode.DONE
