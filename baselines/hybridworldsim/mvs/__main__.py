"""``python -m hybridworldsim.mvs DATASET --split NAME --method plane-sweep``."""

from __future__ import annotations

import sys

import tyro

from hybridworldsim.mvs.methods import Method
from hybridworldsim.mvs.options import Options
from mirror.command_line import parsed
from mirror.errors import ExitCode, MirrorError
from mirror.cli.command import run_process
from mirror.cli.stops import run_process


def _main() -> int:
    from hybridworldsim.mvs.command import main

    dataset: tyro.conf.Positional[str]
    """The dataset's folder."""
    split: str
    """Name of the split; only its training traversals are read."""
    method: Method = "plane-sweep"
    """What estimates depth; sparse: no depth, points matched and triangulated."""
    weights: Path | None = None
    """Path of the weights of a learned method."""
    version: str | None = None
    """Version of the layers; default: the split's name."""
    options: tyro.conf.OmitArgPrefixes[Options] = field(default_factory=Options)


def main() -> int:
    """Run the command line."""
    import mirror
    from hybridworldsim.mvs.run import initialise
    from mirror.progress import progress_bar

    try:
        arguments = parsed(Arguments, sys.argv[1:], "python -m hybridworldsim.mvs")
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
    except MirrorError as error:
        print(f"mvs: {error}", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    points = ", ".join(f"{count} {kind}" for kind, count in report.points.items())
    print(f"layers {report.layer}: {len(report.written)} traversals written, {len(report.kept)} there already")
    if report.written:
        print(f"{report.pictures} pictures, {report.known_share:.1%} of static pixels with a depth; points: {points}")
    return ExitCode.DONE
    return main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(run_process("python -m hybridworldsim.mvs", _main))
