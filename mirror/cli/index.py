"""``mirror index DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode

_EXAMPLES = ("mirror index demo/dataset", "mirror index demo/dataset --force --json")


@dataclass(frozen=True)
class Arguments:
    """Rebuild the index tables from drives, traversals and layers. Their bytes do not depend on the order of ingest."""

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    force: bool = False
    """Rebuild every scene, also those that are up to date."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror index", examples=_EXAMPLES)

    from mirror.dataset.index import build_index
    from mirror.dataset.layout import Layout, require_dataset
    from mirror.dataset.lock import writer_lock

    layout = Layout(arguments.dataset)
    require_dataset(layout)
    with writer_lock(layout, wait=arguments.wait):
        report = build_index(layout.root, force=arguments.force, check_sizes=True)
    if arguments.json:
        print(json.dumps(asdict(report)))
        return ExitCode.DONE
    rows = ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in report.rows.items() if count)
    print(f"{len(report.scenes_written)} scenes written, {len(report.scenes_kept)} up to date; {rows}")
    print(f"index: {layout.index} ({report.seconds:.1f} s)")
    return ExitCode.DONE
