"""``mirror index DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from mirror.command_line import is_url, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror index demo/dataset --compact",
    "mirror index demo/dataset --force --json",
)


@dataclass(frozen=True)
class Arguments:
    """Bring the index tables up to date with drives, traversals and layers, and put a snapshot with the result.

    A compact index has one file a table and scene; its bytes do not depend on the order of ingest.
    """

    dataset: tyro.conf.Positional[str]
    """Folder of the dataset, or s3://BUCKET/PATH."""
    force: bool = False
    """Derive everything again, also what is up to date."""
    compact: bool = False
    """Make one segment of all that runs of `mirror ingest` and others added; earlier snapshots stay."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror index", examples=_EXAMPLES)

    from mirror.dataset.destination import bucket_at
    from mirror.dataset.index import build_bucket_index, build_index
    from mirror.dataset.layout import Layout, require_dataset
    from mirror.dataset.lock import writer_lock

    if is_url(arguments.dataset):
        bucket = bucket_at(arguments.dataset)
        index = f"{bucket.url}/index"
        report = build_bucket_index(bucket, force=arguments.force, compact=arguments.compact)
    else:
        layout = Layout(Path(arguments.dataset))
        require_dataset(layout)
        index = str(layout.index)
        with writer_lock(layout, wait=arguments.wait):
            report = build_index(layout.root, force=arguments.force, compact=arguments.compact, check_sizes=True)
    if arguments.json:
        print(json.dumps(asdict(report)))
        return ExitCode.DONE
    rows = ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in report.rows.items() if count)
    print(f"{len(report.scenes_written)} scenes written, {len(report.scenes_kept)} up to date; {rows}")
    segments = "1 segment" if report.segments == 1 else f"{report.segments} segments"
    print(f"index: {index}, snapshot {report.snapshot} of {segments} ({report.seconds:.1f} s)")
    return ExitCode.DONE
