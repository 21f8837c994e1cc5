"""``mirror view DATASET [MODEL]``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.addresses import require_listening
from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.arrays import Float64
    from mirror.dataset.dataset import Dataset

_EXAMPLES = (
    "mirror view demo/block/dataset demo/block/model",
    "mirror view demo/dataset --scene street --save street.rrd",
)


@dataclass(frozen=True)
class Arguments:
    """Look at a dataset in rerun, or drive and fly through a reconstructed street in the browser.

    With MODEL, a server prints its address and renders the street: sliders move along a traversal, beside
    its line, and from day to night. Without MODEL, rerun shows the cameras, trajectories, boxes, points and masks of a
    scene.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    model: tyro.conf.Positional[Annotated[Path | None, help_text(default="look at the dataset")]] = None
    """Folder that `mirror reconstruct` wrote."""
    scene: Annotated[str | None, help_text(default="the only one, or that of the model", metavar="ID")] = None
    """Scene to look at."""
    traversal: Annotated[tuple[str, ...], help_text(default="all; for MODEL its first", metavar="ID ...")] = ()
    """Traversals to look at."""
    camera: Annotated[tuple[str, ...], help_text(default="all; for MODEL one", metavar="NAME ...")] = ()
    """Cameras to look at."""
    boxes: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of boxes for rerun."""
    points: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of points for rerun."""
    poses: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of poses for rerun."""
    save: Annotated[Path | None, help_text(default="open the viewer", metavar="FILE.rrd")] = None
    """File of rerun to write."""
    width: Annotated[int, help_text(metavar="PIXELS")] = 640
    """Images of rerun that are wider are scaled down."""
    every: int = 1
    """Show every n-th frame in rerun."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of MODEL's method, if that is not installed: that of the training."""
    device: Annotated[str | None, help_text(default="auto", metavar="auto|cpu|cuda[:N]")] = None
    """Device that renders MODEL. auto: a GPU that torch and gsplat can use, else the CPU. The first line says which."""
    host: str = "127.0.0.1"
    """Address of the server for MODEL; 0.0.0.0 lets other machines connect."""
    port: int = 8080
    """Port of the server for MODEL."""
    measure: Annotated[int | None, help_text(default="no", metavar="MOVES")] = None
    """Measure the time of moves at 480 x 270 pixels, print it and end."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror view", examples=_EXAMPLES)
    if arguments.every < 1 or arguments.width < 16:
        raise UsageError(
            f"--every {arguments.every}, --width {arguments.width}", expected="at least 1 frame and 16 pixels"
        )
    of_rerun = ("save", "boxes", "points", "poses")
    named = [f"--{name}" for name in of_rerun if getattr(arguments, name) is not None]
    for option in ("method", "device"):
        if arguments.model is None and getattr(arguments, option) is not None:
            raise UsageError(
                getattr(arguments, option), place=f"--{option}", expected="none without MODEL: a model is rendered"
            )
    if arguments.model is not None and named:
        raise UsageError(f"MODEL and {named[0]} exclude each other", place=named[0], expected="one of them")
    if arguments.save is not None and arguments.save.suffix != ".rrd":
        raise UsageError(f"{arguments.save}", place="--save", expected="a name that ends in .rrd")

    if arguments.measure is not None and arguments.measure < 1:
        raise UsageError(
            f"{arguments.measure}", place="--measure", expected="a whole number of at least 1",
            remedy="give another number with --measure",
        )  # fmt: skip

    from mirror.dataset import open as open_dataset

    if arguments.model is None and (Path(arguments.dataset) / "reconstruction.json").is_file():
        raise UsageError(
            "this is a model, not a dataset", file=arguments.dataset, place="DATASET",
            expected="the dataset of its images, which are shown beside it",
            remedy=f"mirror view DATASET {arguments.dataset}",
        )  # fmt: skip
    dataset = open_dataset(arguments.dataset)
    return _view_dataset(dataset, arguments) if arguments.model is None else _view_model(dataset, arguments)


def _view_dataset(dataset: Dataset, arguments: Arguments) -> int:
    from mirror.cli.layers import with_named_layers
    from mirror.progress import progress_bar
    from mirror.schema.folders import require_output_file
    from mirror.view.rerun_log import RerunOptions, log_scene

    if arguments.save is not None:
        require_output_file(arguments.save, place="--save")
    view = dataset.where(traversal=arguments.traversal or None, camera=arguments.camera or None)
    scenes = view.scenes()
    if arguments.scene is None and len(scenes) != 1:
        raise UsageError(
            f"the dataset has {len(scenes)} scenes: {', '.join(scenes[:8])}", file=dataset.root, place="--scene",
            expected="one scene", remedy="choose one with --scene",
        )  # fmt: skip
    scene = arguments.scene or scenes[0]
    named = {"boxes": arguments.boxes, "points": arguments.points, "poses": arguments.poses}
    view = with_named_layers(view, scene, named, read=("boxes", "points"))
    options = RerunOptions(arguments.save, arguments.width, arguments.every)
    with progress_bar(quiet=arguments.json) as progress:
        logged = log_scene(view, scene, options, progress=progress)
    if arguments.json:
        print(json.dumps({"out": None if arguments.save is None else str(arguments.save), **asdict(logged)}))
    else:
        counts = ", ".join(f"{count:,} {name}" for name, count in asdict(logged).items() if count)
        print(f"{counts}: {arguments.save or 'rerun'}")
    return ExitCode.DONE


def _view_model(dataset: Dataset, arguments: Arguments) -> int:
    from mirror.devices import AUTO
    from mirror.methods.interactive import TrainedAppearance
    from mirror.methods.model import ModelFolder
    from mirror.methods.model_document import read_reconstruction, require_matching_split
    from mirror.view.street_path import read_path
    from mirror.view.street_viewer import StreetViewer, ViewerOptions, measure_moves

    model = arguments.model
    if model is None:
        raise UsageError("no model", place="MODEL", expected="the folder of a model")
    require_listening(arguments.host, arguments.port)
    document = read_reconstruction(model)
    dataset = dataset.with_layers(poses=document.poses)
    require_matching_split(dataset, document.split, document)
    if arguments.scene not in (None, document.scene):
        raise UsageError(f"the model is of {document.scene}", place="--scene", expected=document.scene)
    view = dataset.where(scene=document.scene, traversal=arguments.traversal or sorted(document.trained))
    view = view.with_layers(calibrations=document.calibrations)
    path = read_path(view, view.traversals()[0], arguments.camera[0] if arguments.camera else None)
    trained = dataset.where(traversal=sorted(document.trained))
    rows = trained.table("traversals", ["traversal_id", "light", "weather"]).to_pylist()
    appearances = [TrainedAppearance(**row) for row in sorted(rows, key=lambda row: row["traversal_id"])]
    opened = ModelFolder.read(model, arguments.method)
    device = opened.choose_device(arguments.device or AUTO)
    if not arguments.json:
        print(device, flush=True)
    renderer = opened.open_interactive(appearances, device=device.name)
    if arguments.measure is not None:
        return _print_times(measure_moves(renderer, path, arguments.measure), as_json=arguments.json)
    viewer = StreetViewer(renderer, path, ViewerOptions(arguments.host, arguments.port))
    print(json.dumps({"url": viewer.url}) if arguments.json else f"open {viewer.url} (Ctrl-C ends)", flush=True)
    try:
        viewer.wait()
    finally:
        viewer.close()
    return ExitCode.DONE


def _print_times(seconds: Float64, *, as_json: bool) -> int:
    import numpy as np

    (median, core), (mean, mean_core) = np.median(seconds, axis=0), np.mean(seconds, axis=0)
    if as_json:
        figures = {"median_s": median, "mean_s": mean, "median_core_s": core, "mean_core_s": mean_core}
        print(json.dumps({"moves": len(seconds), **{name: float(value) for name, value in figures.items()}}))
    else:
        print(
            f"{len(seconds)} moves of 0.5 m at 480 x 270: median {1e3 * median:.0f} ms ({1 / median:.1f} a second),"
            f" mean {1e3 * mean:.0f} ms; processor time of all threads: median {1e3 * core:.0f} ms, mean"
            f" {1e3 * mean_core:.0f} ms"
        )
    return ExitCode.DONE
