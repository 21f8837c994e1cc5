"""``mirror export-ply MODEL --dataset DATASET --out STREET.ply``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError


@dataclass(frozen=True)
class Arguments:
    """Write a trained model as the PLY of 3D Gaussian Splatting, as one camera on one drive sees it.

    It opens in viewers such as SuperSplat and viser. How much the pictures lose is measured and said.
    """

    model: tyro.conf.Positional[Path]
    """Folder that `mirror reconstruct` wrote."""
    dataset: str
    """The dataset's folder or URL: for poses and lenses."""
    out: Path
    """The file, .ply."""
    traversal: str | None = None
    """Whose look and driven line. Default: the first that was trained on."""
    camera: str | None = None
    """Whose look. Default: the first of the rig."""
    appearance: str | None = None
    """Another look: mean, a traversal, or a word of light or weather such as night. Default: the traversal's own."""
    degree: int = 3
    """Of the spherical harmonics, 0 to 3: 0 is smallest, and looks the same from everywhere."""
    sky: Literal["pull", "clip", "keep"] = "pull"
    """What lies beyond --reach is pulled in to it (viewers sort what is near less well where something is very far),
    clipped, or kept."""
    reach: float = 150.0
    """Metres from the middle of the street, or more: as far as its blocks go."""
    json: bool = False
    """Print what was written as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror export-ply")
    if arguments.out.suffix != ".ply":
        raise UsageError(f"{arguments.out}", place="--out", expected="a name that ends in .ply")
    if not 0 <= arguments.degree <= 3:
        raise UsageError(f"{arguments.degree}", place="--degree", expected="0 to 3")
    if not arguments.reach > 0.0:
        raise UsageError(f"{arguments.reach:g} m", place="--reach", expected="more than nothing")
    if (arguments.appearance or "").startswith("sweep:"):
        raise UsageError("a sweep is for trajectories", place="--appearance", expected="one look")

    import mirror
    from mirror.methods.appearance import AppearancePolicy
    from mirror.methods.model_document import read_reconstruction, require_matching_split
    from mirror.methods.ply_export import PlyExportOptions, find_ply_exporter
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views.trajectories import plan_views_along, recorded_trajectory
    from mirror.schema.folders import require_output_file

    require_output_file(arguments.out)
    document = read_reconstruction(arguments.model)
    whole = mirror.open(arguments.dataset)
    require_matching_split(whole, document.split, document)
    dataset = whole.where(scene=document.scene)
    traversal = arguments.traversal or dataset.where(split=document.split, role="train").traversals()[0]
    cameras = None if arguments.camera is None else [arguments.camera]
    pixels = load_protocol("static-reconstruction").pixels
    views = plan_views_along(dataset, traversal, recorded_trajectory(dataset, traversal).resample(2.0), pixels, cameras)
    views = tuple(view for view in views if view.camera == views[0].camera)
    appearance = AppearancePolicy(arguments.appearance or "nearest", views, everywhere=arguments.appearance is not None)
    options = PlyExportOptions(arguments.degree, arguments.sky, arguments.reach)
    baking = find_ply_exporter(document.method).export_ply(arguments.model, views, arguments.out, options, appearance)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **asdict(baking)}))
    else:
        print(
            f"{baking.gaussians} Gaussians, {baking.bytes / 1e6:.1f} MB, as {views[0].camera} of {traversal} sees them;"
            f" {baking.psnr_db:.1f} dB PSNR to the model's pictures: {arguments.out}"
        )
    return ExitCode.DONE
