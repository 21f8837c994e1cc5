"""``mirror deidentify DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode
from mirror.executors.arguments import ExecutorArguments

if TYPE_CHECKING:
    from mirror.privacy.options import DeidentifyOptions
    from mirror.privacy.run import DeidentifyReport

_LISTED_FAILURES = 20
_EXAMPLES = (
    "mirror deidentify demo/dataset --plate-region CN",
    "mirror deidentify demo/dataset --detector yunet=yunet_n_dynamic.onnx --detector world_plates --plate-region EU",
)


@dataclass(frozen=True)
class Arguments:
    """Remove faces, number plates and metadata from the images of a dataset; see docs/privacy.md.

    The recorded images are not changed: redacted ones are written as a layer, which readers get in their place, with a
    log of what was removed and masks that training and scoring leave out. An interrupted run is resumed by the same
    command. Without a detector of the plates of --plate-region nothing is written.

    Exit codes: 0 done, 2 could not run, 3 some images failed: their traversals are not complete.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    plate_region: Annotated[str | None, help_text(metavar="REGION", default="must be stated")] = None
    """Region of the number plates, such as CN or EU. A chosen plate detector must cover it. ANY: from anywhere;
    a release then needs a review."""
    detector: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        help_text(metavar="NAME[=FILE][@REGIONS]", default="centerface and world_plates; for CN clp_det too"),
    ] = ()
    """A detector, its weights, and the regions of its plates. Several of a kind are joined; see --list-detectors."""
    list_detectors: bool = False
    """List the installed detectors and do nothing else."""
    traversal: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="ID", default="all")] = ()
    """Only this traversal."""
    version: str = "1"
    """Version of the layers. Other options need another version; readers get the newest."""
    faces: Literal["cells", "fill"] = "cells"
    """What replaces a face: 4 x 4 mean colours, smoothed, or one mean colour. Plates get one mean colour."""
    grow: float = 0.3
    """Share by which a region is enlarged, half on each side."""
    skip_ego: bool = True
    """Do not search tiles that show the recording vehicle only."""
    skip_sky: bool = True
    """Do not search tiles that show the sky only, where a layer of masks says so."""
    skip_without_boxes: bool = False
    """Do not search images in which no 3D box is visible. It trusts the annotation."""
    tracks: bool = True
    """Redact along tracks too, in images in which the detector missed."""
    cameras: bool = True
    """Redact in the other cameras of an instant too."""
    vehicles: bool = True
    """Redact the front and rear of vehicles' 3D boxes where no plate was detected."""
    least_plate_px: float = 20.0
    """Width, in pixels of the image, from which a plate that was not detected is redacted at a vehicle's box."""
    box_error_m: float = 0.0
    """Error of the 3D boxes, in metres: what is redacted at a box becomes larger by it on each side."""
    withhold_failed: bool = False
    """Complete traversals without the images that failed. A release leaves these out."""
    images: Annotated[Literal["files", "shards"] | None, help_text(default="as the recorded images are")] = None
    """Form of the redacted images: a file each, or side by side in tar archives of 64 MiB, frame by frame. Layers that
    are complete stay as they are."""
    workers: Annotated[int | None, help_text(default="one a core")] = None
    """Number of processes."""
    executor: tyro.conf.OmitArgPrefixes[ExecutorArguments] = field(default_factory=ExecutorArguments)
    timeout_s: float = 120.0
    """Longest time that the detectors may take for one image."""
    wait: bool = False
    """Wait until no other run writes the dataset."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror deidentify", examples=_EXAMPLES)
    if arguments.list_detectors:
        _print_detectors()
        return ExitCode.DONE

    from mirror.privacy.run import deidentify
    from mirror.progress import progress_bar

    options = _options(arguments)
    with progress_bar(quiet=arguments.json) as bar:
        report = deidentify(
            arguments.dataset, options, traversals=arguments.traversal or None, progress=bar, wait=arguments.wait
        )
    if arguments.json:
        print(json.dumps(_plain(report, arguments.dataset)))
    else:
        _print(report, arguments.dataset)
    return report.exit_code()


def _options(arguments: Arguments) -> DeidentifyOptions:
    from mirror.pools import usable_cores
    from mirror.privacy.detectors.registry import default_choices, parse_choice
    from mirror.privacy.operators import Redaction
    from mirror.privacy.options import DeidentifyOptions, Propagation, SkipRules
    from mirror.privacy.propagation.vehicles import StripOptions

    return DeidentifyOptions(
        detectors=[parse_choice(text) for text in arguments.detector] or default_choices(arguments.plate_region),
        plate_region=arguments.plate_region,
        version=arguments.version,
        redaction=Redaction(face=arguments.faces, grow=arguments.grow),
        skip=SkipRules(arguments.skip_ego, arguments.skip_sky, arguments.skip_without_boxes),
        propagation=Propagation(
            arguments.tracks,
            arguments.cameras,
            arguments.vehicles,
            strips=StripOptions(arguments.least_plate_px, arguments.box_error_m),
        ),
        workers=arguments.workers or usable_cores(),
        executor=arguments.executor.choose("processes", arguments.workers),
        timeout_s=arguments.timeout_s,
        withhold_failed=arguments.withhold_failed,
        shards=None if arguments.images is None else arguments.images == "shards",
    )


def _print_detectors() -> None:
    from mirror.privacy.detectors.registry import installed_detectors

    for name, known in installed_detectors().items():
        covers = f"; plates of {', '.join(sorted(known.plate_regions))}" if known.plate_regions else ""
        print(f"{name:<16} {known.kind:<6} {known.summary}{covers}")


def _plain(report: DeidentifyReport, dataset: Path) -> dict[str, object]:
    return {
        "dataset": str(dataset),
        "version": report.version,
        "written": report.written,
        "unchanged": report.unchanged,
        "unfinished": report.unfinished,
        "images": report.images,
        "redacted": report.redacted,
        "regions": dict(sorted(report.regions.items())),
        "skipped": dict(sorted(report.skipped.items())),
        "failures": [vars(one) for one in report.failures],
        "broken": report.broken,
    }


def _print(report: DeidentifyReport, dataset: Path) -> None:
    regions = ", ".join(f"{count} {name}" for name, count in sorted(report.regions.items())) or "none"
    print(f"{len(report.written)} traversals written, {len(report.unchanged)} unchanged, version {report.version}")
    print(f"{report.images:,} images, {report.redacted:,} of them with regions; regions by kind and origin: {regions}")
    if report.skipped:
        print("not searched: " + ", ".join(f"{count:,} {name}" for name, count in sorted(report.skipped.items())))
    for one in report.failures[:_LISTED_FAILURES]:
        print(f"{one.status}: {one.traversal_id}, camera {one.camera}, {one.timestamp_ns}: {one.problem}")
    if len(report.failures) > _LISTED_FAILURES:
        print(f"... and {len(report.failures) - _LISTED_FAILURES} more images; --json lists all")
    for name, reason in report.broken.items():
        print(f"{name}: {reason}")
    if report.unfinished:
        print(
            f"{len(report.unfinished)} traversals are not complete: correct what failed and run the same command again,"
            " or leave the images out with --withhold-failed"
        )
    print(f"dataset: {dataset}")
