"""``mirror export colmap DATASET --out DIR``, and the same for the other formats."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode

_EXAMPLES: Final = {
    "colmap": (
        "mirror export colmap demo/dataset --scene street --split novel --out colmap",
        "mirror export colmap demo/dataset --scene street --camera front_wide rear --undistort --out colmap",
    ),
    "nerfstudio": (
        "mirror export nerfstudio demo/dataset --scene street --split novel --out nerfstudio",
        "mirror export nerfstudio demo/dataset --scene street --undistort --copy --out nerfstudio",
    ),
    "gsplat": (
        "mirror export gsplat demo/dataset --scene street --out gsplat",
        "mirror export gsplat demo/dataset --scene street --undistort --split novel --out gsplat",
    ),
    "nuscenes": (
        "mirror export nuscenes demo/dataset --scene street --undistort --out nuscenes",
        "mirror export nuscenes demo/dataset --scene street --boxes petr@1 --undistort --out nuscenes",
    ),
    "kitti": (
        "mirror export kitti demo/dataset --scene street --undistort --out kitti",
        "mirror export kitti demo/dataset --scene street --camera front_wide --undistort --out kitti",
    ),
    "webdataset": (
        "mirror export webdataset demo/dataset --scene street --split novel --out shards",
        "mirror export webdataset demo/dataset --scene street --camera front_wide rear --undistort --out shards",
    ),
    "lerobot": (
        "mirror export lerobot demo/dataset --scene street --traversal street.drive-01.1747209979231 --out lerobot",
        "mirror export lerobot demo/dataset --scene street --camera front_wide --split novel --out lerobot",
    ),
    "ncore": (
        "mirror export ncore demo/dataset --scene street --out ncore",
        "mirror export ncore demo/dataset --scene street --camera front_wide --boxes petr@1 --out ncore",
    ),
}
_SUMMARIES: Final = {
    "colmap": "a COLMAP 4 model: cameras, rigs, frames, images, points, masks",
    "nerfstudio": "transforms.json with images, masks and points",
    "gsplat": "the data of gsplat's example trainer",
    "nuscenes": "the tables of nuScenes with images and boxes",
    "kitti": "KITTI odometry sequences with tracking labels",
    "webdataset": "tar files with one sample for each frame",
    "lerobot": "a LeRobot v3.0 dataset with an episode for each traversal, split at gaps in time",
    "ncore": "NVIDIA NCore V4 stores, one for each traversal, with every lens, shutter, boxes and masks",
}
_WITH_BOXES: Final = ("nuscenes", "kitti", "webdataset", "ncore")


@dataclass(frozen=True)
class Arguments:
    """Write a scene in the format of another toolkit. Images are hard links to those of the dataset where possible.

    An interrupted call continues when it is repeated. `export.json` states what was written, and what the format cannot
    hold; `images.csv` states the traversal, camera, time and role of each image.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """Folder to write."""
    scene: Annotated[str | None, help_text(default="the only one", metavar="ID")] = None
    """Scene to export."""
    traversal: Annotated[tuple[str, ...], help_text(default="all", metavar="ID ...")] = ()
    """Traversals to export."""
    camera: Annotated[tuple[str, ...], help_text(default="all", metavar="NAME ...")] = ()
    """Cameras to export."""
    split: Annotated[str | None, help_text(default="no roles", metavar="NAME")] = None
    """Split whose roles are exported. Points then come from training traversals only."""
    poses: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of poses."""
    boxes: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of boxes."""
    points: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of points."""
    undistort: bool = False
    """Resample images of distorted lenses to pinhole cameras."""
    copy: bool = False
    """Copy images, for tools that change them: a hard link is the file of the dataset."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    commands = {name: Subcommand(summary, partial(_run, name)) for name, summary in _SUMMARIES.items()}
    return run_subcommand(argv, "mirror export", commands)


def _run(layout: str, argv: Sequence[str]) -> int:
    arguments = parse_arguments(Arguments, argv, f"mirror export {layout}", examples=_EXAMPLES[layout])

    from mirror.cli.layers import with_named_layers
    from mirror.dataset import open as open_dataset
    from mirror.export.run import ExportOptions, export
    from mirror.progress import progress_bar

    dataset = open_dataset(arguments.dataset)
    dataset = dataset.where(traversal=arguments.traversal or None, camera=arguments.camera or None)
    named = {"poses": arguments.poses, "boxes": arguments.boxes, "points": arguments.points}
    read = ("points", "boxes") if layout in _WITH_BOXES else ("points",)
    dataset = with_named_layers(dataset, arguments.scene, named, read=read)
    options = ExportOptions(arguments.scene, arguments.split, arguments.undistort, arguments.copy)
    with progress_bar(quiet=arguments.json) as progress:
        written = export(dataset, layout, arguments.out, options, progress=progress)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **written.model_dump(mode="json")}))
        return ExitCode.DONE
    counts = {
        "images": written.images,
        "masks": written.masks,
        "points": written.points,
        "boxes": written.boxes,
    }
    print(", ".join(f"{count:,} {name}" for name, count in counts.items() if count))
    if written.withheld:
        print(f"left out: {written.withheld:,} images that the published dataset or the redaction withholds")
    if written.without_frame:
        print(f"left out: {written.without_frame:,} images that belong to no frame")
    for note in written.notes:
        print(f"note: {note}")
    print(f"not in this format: {'; '.join(written.lost)}")
    print(f"{layout}: {arguments.out}")
    return ExitCode.DONE
