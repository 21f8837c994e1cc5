"""``mirror render MODEL --dataset DATASET``: a submission, or pictures along a trajectory."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.arrays import UInt8
    from mirror.dataset.dataset import Dataset
    from mirror.evaluation.submission.manifest import Appearance, Runtime
    from mirror.evaluation.submission.writing import Render
    from mirror.methods.appearance import AppearancePolicy
    from mirror.protocols.views.plan import Plan
    from mirror.protocols.views.view import RenderView

_VIDEOS = (".mp4", ".mkv")
_HZ = 10.0
_NO_VIDEOS = (".avi", ".gif", ".m4v", ".mov", ".mpeg", ".mpg", ".ogv", ".webm", ".wmv")


@dataclass(frozen=True)
class Arguments:
    """Render a trained model.

    With --split, the views that a protocol asks for: a submission that `mirror evaluate` takes. With --trajectory,
    where nobody drove: a video, or a folder of pictures.
    """

    model: tyro.conf.Positional[tuple[Path, ...]]
    """Folder that `mirror reconstruct` wrote; for a split of several scenes one of each."""
    dataset: str
    """The dataset's folder or URL: for poses and lenses; with --appearance fit, for the left half of pictures too."""
    out: Path
    """A new folder; along a trajectory also FILE.mp4."""
    split: str | None = None
    """Name of the split to write a submission for."""
    protocol: str = "static-reconstruction"
    """Name of the protocol, or the path of its .toml."""
    trajectory: str | None = None
    """A traversal, lane-shift:METRES to its left, forward:METRES ahead of it, or a CSV or Parquet of poses (qw qx qy
    qz tx_m ty_m tz_m, in the world of the scene; timestamp_ns, else --hz says how fast they follow)."""
    traversal: str | None = None
    """Whose rig, line and look a trajectory has. Default: the first that was trained on."""
    cameras: str | None = None
    """Of the rig, separated by commas. Default: all."""
    appearance: str = "nearest"
    """nearest, mean, fit, a traversal, a word of light or weather such as night, or sweep:A:B; along a trajectory also
    of cameras, such as rear=night,front_wide=sweep:day:night. In a submission what was trained on keeps its own look;
    along a trajectory only the light changes, nothing moves."""
    width: int | None = None
    """Pictures along a trajectory are no wider. Default: what the protocol says."""
    hz: float | None = None
    """Pictures a second along a trajectory. Default: 10."""
    json: bool = False
    """Print what was written as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror render")
    if (arguments.split is None) == (arguments.trajectory is None):
        raise UsageError("what shall be rendered?", expected="--split for a submission, or --trajectory, one of them")
    if arguments.width is not None and arguments.width < 1:
        raise UsageError(f"{arguments.width}", place="--width", expected="1 or more")
    if arguments.out.suffix.lower() in _NO_VIDEOS:
        raise UsageError(
            f"{arguments.out}", place="--out", expected=f"a folder, or a name that ends in {' or '.join(_VIDEOS)}"
        )
    if not arguments.model:
        raise UsageError("no model", place="MODEL", expected="a folder that `mirror reconstruct` wrote")

    import mirror
    from mirror.schema.folders import FolderKind, require_output_file, require_output_folder

    if arguments.trajectory is not None and _is_film(arguments.out):
        require_output_file(arguments.out)
    else:
        require_output_folder(arguments.out, FolderKind.SUBMISSION)
    dataset = mirror.open(arguments.dataset)
    return _trajectory(arguments, dataset) if arguments.trajectory is not None else _submission(arguments, dataset)


def _is_film(out: Path) -> bool:
    return out.suffix.lower() in _VIDEOS


def _submission(arguments: Arguments, dataset: Dataset) -> int:
    from mirror.evaluation.scorers import load_scorer
    from mirror.evaluation.submission.manifest import Method
    from mirror.evaluation.submission.writing import write_submission
    from mirror.methods.appearance import AppearancePolicy
    from mirror.methods.model_document import read_reconstruction, require_held_out_images, require_matching_split
    from mirror.methods.registry import installed_method, read_licence
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views

    for option in ("traversal", "cameras", "width", "hz"):
        if getattr(arguments, option) is not None:
            raise UsageError(
                "it is for trajectories", place=f"--{option}",
                expected=f"no such option: protocol {arguments.protocol} says what a submission holds",
            )  # fmt: skip
    for sign, what in (("sweep:", "a sweep is"), ("=", "looks by camera are")):
        if sign in arguments.appearance:
            raise UsageError(f"{what} for trajectories", place="--appearance", expected="one look for all views")
    name, models = _models(arguments.model)
    split, protocol = str(arguments.split), load_protocol(arguments.protocol)
    for model in models.values():
        document = read_reconstruction(model)
        require_matching_split(dataset, split, document)
        require_held_out_images(protocol, document)
    plan = plan_views(dataset, protocol, split)
    bare = sorted({view.scene_id for view in plan.views} - set(models))
    if bare:
        raise UsageError(
            f"split {split} has views of {', '.join(bare)} too", expected="a model of each of its scenes",
            remedy="reconstruct them, and name all models; or make a split of fewer scenes",
        )  # fmt: skip
    appearance = AppearancePolicy(arguments.appearance, plan.views, truth=(dataset, plan))

    def renderer(_: Dataset, asked: Plan) -> Iterator[Render]:
        for scene, model in models.items():
            own = [view for view in asked.views if view.scene_id == scene]
            if own:
                render = installed_method(name).open(model, appearance)
                yield from (([view], render(view)) for view in own)

    about = Method(name=name, licence=read_licence(name), trained_on=_trained_on(models.values()))
    with progress_bar(quiet=arguments.json) as bar:
        count = write_submission(
            dataset, plan, renderer, about, appearance_of(appearance), arguments.out, bar, _costs(models.values()),
            of=_hash(models.values()),
        )  # fmt: skip
    said = {"out": str(arguments.out), "views": count, "method": name}
    print(json.dumps(said) if arguments.json else f"{count} renders by {name}: {arguments.out}")
    if not arguments.json:
        more = " --hidden FOLDER" if load_scorer(protocol.task).needs_hidden(plan) else ""
        print(f"next: mirror evaluate {arguments.out} --truth {arguments.dataset}{more}")
    return ExitCode.DONE


def _models(folders: Sequence[Path]) -> tuple[str, dict[str, Path]]:
    """The method of models, and each by its scene."""
    from mirror.methods.model_document import read_reconstruction

    documents = [(folder, read_reconstruction(folder)) for folder in folders]
    methods = sorted({document.method for _, document in documents})
    scenes = {document.scene: folder for folder, document in documents}
    if len(methods) != 1 or len(scenes) != len(documents):
        raise UsageError(
            f"{len(documents)} models by {', '.join(methods)} of {len(scenes)} scenes",
            expected="models by one method, one of each scene",
        )
    return methods[0], scenes


def _hash(models: Iterable[Path]) -> str:
    """Of the documents of models, which say what each took: no two trainings took the same."""
    from mirror.methods.model_document import DOCUMENT

    return hashlib.sha256(b"".join((model / DOCUMENT).read_bytes() for model in models)).hexdigest()


def _trained_on(models: Iterable[Path]) -> str:
    from mirror.methods.model_document import read_reconstruction

    documents = [read_reconstruction(model) for model in models]
    withheld = sum(one.withheld for one in documents)
    alone = f"training traversals of split {', '.join(sorted({one.split for one in documents}))}, of the scene alone"
    return f"{alone}, without {withheld} of their pictures" if withheld else alone


def _costs(models: Iterable[Path]) -> Runtime:
    from mirror.evaluation.submission.manifest import Runtime
    from mirror.methods.model_document import read_reconstruction

    device = f"{platform.machine()} CPU"
    costs = [read_reconstruction(model).done for model in models]
    known = [one for one in costs if one is not None]
    if len(known) < len(costs):
        return Runtime(device=device)
    return Runtime(
        device=device,
        model_bytes=sum(one.model_bytes for one in known),
        driven_m=sum(one.driven_m for one in known),
        training_s=sum(one.wall_s for one in known),
    )


def appearance_of(appearance: AppearancePolicy) -> Appearance:
    """What a manifest says of the looks of pictures that were not trained on."""
    from mirror.evaluation.submission.manifest import Appearance
    from mirror.methods.appearance import FITTED_PART

    if appearance.policy == "nearest":
        return Appearance(policy="nearest-traversal", description="by the symmetric chamfer distance of driven lines")
    if appearance.policy == "mean":
        return Appearance(policy="mean", description="of the latents of the camera")
    if appearance.policy == "fit":
        return Appearance(policy="fitted", description="the latent alone", held_out_pixels=(FITTED_PART,))
    return Appearance(policy="other", description=f"given: {appearance.policy}")


def _trajectory(arguments: Arguments, dataset: Dataset) -> int:
    from mirror.methods.appearance import AppearancePolicy
    from mirror.methods.camera_policies import open_by_camera, parse_camera_policies
    from mirror.methods.model_document import read_reconstruction, require_matching_split
    from mirror.methods.registry import installed_method
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views.trajectories import parse_trajectory, plan_views_along
    from mirror.schema.render_folder import start_render_folder

    pixels = load_protocol(arguments.protocol).pixels
    if arguments.width is not None:
        pixels = pixels.model_copy(update={"max_width_px": arguments.width})
    name, models = _models(arguments.model)
    if len(models) != 1:
        raise UsageError(f"{len(models)} models", expected="one, for a trajectory")
    ((scene, model),) = models.items()
    document = read_reconstruction(model)
    require_matching_split(dataset, document.split, document)
    own = dataset.where(scene=scene)
    base = arguments.traversal or _base(own, str(arguments.trajectory), document.split)
    cameras = None if arguments.cameras is None else arguments.cameras.split(",")
    hz = _HZ if arguments.hz is None else arguments.hz
    trajectory = parse_trajectory(own, str(arguments.trajectory), base, hz).resample(hz)
    views = plan_views_along(own, base, trajectory, pixels, cameras)
    asked = sorted({view.camera for view in views})
    filmed = _is_film(arguments.out)
    if filmed and len(asked) > 1 and len({(v.width_px, v.height_px) for v in views}) > 1:
        raise UsageError(
            f"cameras {', '.join(asked)} have pictures of different sizes", place="--cameras", expected="one of them"
        )
    looks = parse_camera_policies(arguments.appearance, asked)
    render = open_by_camera(installed_method(name), model, AppearancePolicy(views=views, everywhere=True), looks)
    begin = time.perf_counter()
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("rendering", len(views))
        if filmed:
            from mirror.view.video import write_video

            write_video(arguments.out, _side_by_side(views, render, len(asked), bar.advance), hz)
            rendered = len(views)
        else:
            of = (_hash(models.values()), *(view.model_dump_json() for view in views), arguments.appearance)
            start_render_folder(arguments.out, of)
            rendered = _pictures(arguments.out, views, render, bar.advance)
    speed = rendered / (time.perf_counter() - begin)
    said = {"out": str(arguments.out), "pictures": len(views), "method": name, "frames_per_second": speed}
    words = f"{len(views)} pictures by {name}, {speed:.1f} a second: {arguments.out}"
    print(json.dumps(said) if arguments.json else words)
    return ExitCode.DONE


def _base(dataset: Dataset, trajectory: str, split: str) -> str:
    """The traversal that a trajectory goes along, if it names one; else the first that was trained on."""
    if trajectory in dataset.traversals():
        return trajectory
    return dataset.where(split=split, role="train").traversals()[0]


def _side_by_side(
    views: Sequence[RenderView], render: Callable[[RenderView], UInt8], cameras: int, advance: Callable[[int], None]
) -> Iterator[UInt8]:
    import numpy as np

    for start in range(0, len(views), cameras):
        yield np.concatenate([render(view) for view in views[start : start + cameras]], axis=1)
        advance(cameras)


def _pictures(
    out: Path, views: Sequence[RenderView], render: Callable[[RenderView], UInt8], advance: Callable[[int], None]
) -> int:
    """Render what is not there yet; how many that was."""
    from mirror.protocols.png import encode_png
    from mirror.schema.files import write_bytes
    from mirror.schema.render_folder import finish_render_folder

    files = [(view, out / view.camera / f"{view.frame_index:05d}.png") for view in views]
    missing = [(view, file) for view, file in files if not file.is_file()]
    advance(len(files) - len(missing))
    for view, file in missing:
        write_bytes(file, encode_png(render(view)))
        advance(1)
    finish_render_folder(out)
    return len(missing)
