"""``mirror export-ply DATASET MODEL --out STREET.ply``."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

_EXAMPLES = (
    "mirror export-ply demo/block/dataset demo/block/model --out street.ply",
    "mirror export-ply demo/block/dataset demo/block/model --appearance night --degree 0 --out night.ply",
)
_RENAMED = {"--dataset": "DATASET"}


@dataclass(frozen=True)
class Arguments:
    """Write a trained model as the PLY file of 3D Gaussian Splatting, in the appearance of one camera on one drive.

    Viewers such as SuperSplat and viser open it. The verb prints how far renders of the file differ from renders of the
    model. A name that ends in .spz gives SPZ (extra spz), which web viewers open, a tenth of the size.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset: it has the poses and lenses."""
    model: tyro.conf.Positional[Path]
    """Folder that `mirror reconstruct` wrote."""
    out: Annotated[Path, help_text(metavar="FILE.ply")]
    """File to write, .ply or .spz."""
    traversal: Annotated[str | None, help_text(default="the first training traversal", metavar="ID")] = None
    """Traversal that gives the appearance and the driven line."""
    camera: Annotated[str | None, help_text(default="the first of the rig", metavar="NAME")] = None
    """Camera that gives the appearance."""
    appearance: Annotated[str | None, help_text(default="that of --traversal")] = None
    """Another appearance: mean, a traversal, or a word for light or weather such as night."""
    degree: int = 3
    """Degree of the spherical harmonics, 0 to 3. With 0 the file is smallest and colours have no view dependence."""
    sky: Literal["pull", "clip", "keep"] = "pull"
    """Gaussians beyond --reach: pull moves them to that distance, clip removes them, keep leaves them.
    Viewers sort near Gaussians less precisely if some are very far."""
    reach: Annotated[float, help_text(metavar="METRES")] = 150.0
    """Distance from the centre of the street; at least the extent of its blocks."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of a method that is not installed: that of the training."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror export-ply", examples=_EXAMPLES, renamed=_RENAMED)
    if arguments.out.suffix not in (".ply", ".spz"):
        raise UsageError(f"{arguments.out}", place="--out", expected="a name that ends in .ply or .spz")
    if not 0 <= arguments.degree <= 3:
        raise UsageError(f"{arguments.degree}", place="--degree", expected="0 to 3")
    if not arguments.reach > 0.0:
        raise UsageError(f"{arguments.reach:g} m", place="--reach", expected="more than 0 m")
    if (arguments.appearance or "").startswith("sweep:"):
        raise UsageError("a sweep is for trajectories", place="--appearance", expected="one appearance")

    from mirror.dataset import open as open_dataset
    from mirror.methods.appearance import AppearancePolicy, require_known_appearance
    from mirror.methods.model import ModelFolder
    from mirror.methods.model_document import read_reconstruction, require_matching_split
    from mirror.methods.ply_export import PlyExportOptions
    from mirror.methods.spz import require_gsply, write_spz
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views.trajectories import plan_views_along, recorded_trajectory
    from mirror.schema.folders import require_output_file

    require_output_file(arguments.out)
    if arguments.out.suffix == ".spz":
        require_gsply()
    document = read_reconstruction(arguments.model)
    whole = open_dataset(arguments.dataset).with_layers(poses=document.poses)
    require_matching_split(whole, document.split, document)
    if arguments.appearance is not None:
        require_known_appearance(arguments.appearance, whole, document.trained)
    dataset = whole.where(scene=document.scene).with_layers(calibrations=document.calibrations)
    traversal = arguments.traversal or dataset.where(split=document.split, role="train").traversals()[0]
    cameras = None if arguments.camera is None else [arguments.camera]
    pixels = load_protocol("static-reconstruction").pixels
    views = plan_views_along(dataset, traversal, recorded_trajectory(dataset, traversal).resample(2.0), pixels, cameras)
    views = tuple(view for view in views if view.camera == views[0].camera)
    appearance = AppearancePolicy(arguments.appearance or "nearest", views, everywhere=arguments.appearance is not None)
    options = PlyExportOptions(arguments.degree, arguments.sky, arguments.reach)
    model = ModelFolder.read(arguments.model, arguments.method)
    if arguments.out.suffix == ".spz":
        with tempfile.TemporaryDirectory(prefix="mirror-spz-") as folder:
            ply = Path(folder) / "street.ply"
            written = model.export_ply(views, ply, options, appearance)
            written = replace(written, bytes=write_spz(ply, arguments.out).bytes)
    else:
        written = model.export_ply(views, arguments.out, options, appearance)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **asdict(written)}))
    else:
        print(
            f"{written.gaussians} Gaussians, {written.bytes / 1e6:.1f} MB, in the appearance of {views[0].camera} on"
            f" {traversal}; {written.psnr_db:.1f} dB PSNR against renders of the model: {arguments.out}"
        )
    return ExitCode.DONE
