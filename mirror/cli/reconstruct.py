"""``mirror reconstruct DATASET --scene S --split NAME --out MODEL``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import help_text, parse_arguments, parse_settings
from mirror.counting import count_of
from mirror.devices import AUTO, Device, choose_device, require_device_name
from mirror.errors import ExitCode, UsageError
from mirror.executors.arguments import ExecutorArguments
from mirror.plugins import is_file_reference

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset
    from mirror.methods.capabilities import Capabilities
    from mirror.methods.plugin import ReconstructionResult

_EXAMPLES = (
    "mirror reconstruct demo/block/dataset --split novel --minutes 2 --out model",
    "mirror reconstruct demo/block/dataset --split novel --steps 500 --seed 1 --set depth_weight=0.1 --out model",
)


@dataclass(frozen=True)
class Arguments:
    """Reconstruct the static street of a scene from the training traversals of a split.

    Ctrl-C leaves a checkpoint, and the same command continues from it. A finished model is reported and not changed.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset. It must be a local folder if --initialise writes layers of depth,
    one that may be written unless --layers is given."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split. Its held-out traversals are not used."""
    out: Annotated[Path, help_text(metavar="MODEL")]
    """Folder of the model: a new one, or that of an interrupted run with the same options."""
    scene: Annotated[str | None, help_text(default="the only scene of the split", metavar="ID")] = None
    """Scene to reconstruct."""
    method: Annotated[str, help_text(metavar="NAME|FILE.py:OBJECT")] = "hybridworldsim"
    """An installed method (entry points mirror.methods), or an object in a Python file."""
    minutes: Annotated[float | None, help_text(default="10 on a CPU, unless --steps is given")] = None
    """Processor time of training per block in minutes, summed over threads. Excludes --steps."""
    steps: Annotated[int | None, help_text(default="30000 on a GPU, unless --minutes is given")] = None
    """Number of training images per block. Repeats exactly with the same --threads. Excludes --minutes."""
    width: Annotated[int | None, help_text(default="240 on a CPU, 960 on a GPU", metavar="PIXELS")] = None
    """Wider images are scaled down to this width."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "static-reconstruction"
    """Protocol that gives the raster and the masks: a name, or the path of a .toml file."""
    masks: bool = True
    """--no-masks: road users are trained on, by the protocol NAME-unmasked, for recordings without boxes and masks."""
    hold_out: bool = False
    """Leave out the images of training traversals that the protocol asks for: neither colours nor depth are used.
    It makes a test possible where no traversal is held out."""
    seed: int = 0
    """Seed of all random choices."""
    initialise: Annotated[
        str | None, help_text(default="dataset if it has points and nothing is held out, else plane-sweep")
    ] = None
    """plane-sweep, mvsnet, patchmatchnet, sparse: estimate the layers of depth and points that are absent.
    dataset: use the layers of the dataset. SOURCE@VERSION: use this layer."""
    poses: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of poses, such as aligned@1 of mirror align. Renders of trajectories, viewers and exports use it too; views
    of protocols have recorded poses, so that such a model is not scored by them."""
    calibrations: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of calibrations, such as refined@1 of mirror calibrate refine."""
    boxes: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of boxes, by which road users are masked."""
    layers: Annotated[Path | None, help_text(default="the dataset", metavar="FOLDER")] = None
    """Write layers of depth to this copy of the dataset, which is made or brought up to date.
    The dataset is only read. Images of the split are hard links where possible."""
    blocks: Annotated[str | None, help_text(default="all", metavar="NAME,...")] = None
    """Train these blocks only, so that other machines train the others at the same time.
    When all are trained, the same command without --blocks completes the model."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the method, such as depth_weight=0.1 or refinement.max_anchors=9000; run.json of a block has all."""
    threads: Annotated[int | None, help_text(default="one per processor")] = None
    """Number of threads."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that trains. auto: a GPU that torch and gsplat can use, else the CPU. The first line says which."""
    devices: Annotated[str | None, help_text(default="that of --device", metavar="0,1,...")] = None
    """Devices of one kind that train blocks at the same time, one process each: numbers of GPUs, or names."""
    fp16: bool = False
    """Write the model in half precision (16-bit floats)."""
    executor: tyro.conf.OmitArgPrefixes[ExecutorArguments] = field(default_factory=ExecutorArguments)
    workers: Annotated[int | None, help_text(default="one a core, or as many as a cluster has room for")] = None
    """Number of blocks that --executor processes or ray trains at a time. A worker takes one block after another."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror reconstruct", examples=_EXAMPLES, renamed={"--half": "--fp16"})
    for name, number, bound in (
        ("--minutes", arguments.minutes, 0.0),
        ("--steps", arguments.steps, 0.0),
        ("--threads", arguments.threads, 0.0),
        ("--width", arguments.width, 15.0),
    ):
        if number is not None and not number > bound:
            raise UsageError(f"{number:g}", place=name, expected=f"more than {bound:g}")
    if arguments.seed < 0:
        raise UsageError(f"{arguments.seed}", place="--seed", expected="0 or more")
    if arguments.minutes is not None and arguments.steps is not None:
        raise UsageError("--minutes and --steps exclude each other", expected="one of them, or neither")

    from mirror.methods.capabilities import find_capabilities
    from mirror.methods.plugin import ReconstructionTask
    from mirror.methods.registry import load_method, method_label
    from mirror.methods.training_defaults import training_defaults
    from mirror.schema.folders import FolderKind, require_output_folder

    require_output_folder(arguments.out, FolderKind.MODEL)
    method = load_method(arguments.method)
    capabilities = find_capabilities(method)
    executor = None
    if arguments.executor != ExecutorArguments():
        if not capabilities.distributes_blocks:
            raise UsageError(
                f"method {method_label(arguments.method)} trains in one process", place="--executor",
                expected="a method with the capability distributes_blocks", remedy="leave --executor out",
            )  # fmt: skip
        if arguments.devices is not None:
            raise UsageError("--devices and --executor exclude each other", expected="one of them, or neither")
        chosen = arguments.executor.choose("serial", arguments.workers)
        executor = None if chosen.kind == "serial" else chosen
    elif arguments.workers is not None:
        raise UsageError("--workers without --executor", place="--workers", expected="--executor processes or ray")
    devices = _choose_devices(arguments, f"method {method_label(arguments.method)}", capabilities)
    device = devices[0]
    defaults = training_defaults(device.name)
    has_budget = arguments.minutes is not None or arguments.steps is not None
    if not arguments.json:
        print("\n".join(map(str, devices)), flush=True)
        if used := defaults.describe(width=arguments.width is None, budget=not has_budget):
            print(f"defaults on this device: {used}", flush=True)

    from mirror.cli.layers import with_named_layers
    from mirror.dataset.working_copy import update_working_copy
    from mirror.dataset.writing import naming_option, open_to_write
    from mirror.methods.hosting import reconstruct
    from mirror.methods.training_images import list_scored_training_images, list_withheld_images
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol

    protocol = load_protocol(arguments.protocol, masked=arguments.masks)
    if arguments.layers is not None:
        dataset = update_working_copy(Path(arguments.dataset), arguments.layers, arguments.split, place="--layers")
    else:
        with naming_option(Path(arguments.dataset), "--layers FOLDER"):
            dataset = open_to_write(arguments.dataset)
    dataset = dataset.with_layers(poses=arguments.poses, calibrations=arguments.calibrations)
    width_px = defaults.width_px if arguments.width is None else arguments.width
    scaled = protocol.model_copy(update={"pixels": protocol.pixels.model_copy(update={"max_width_px": width_px})})
    scene = _scene(dataset, arguments.split, arguments.scene)
    training = dataset.where(scene=scene, split=arguments.split, role="train")
    read = ("boxes",) if "boxes" in protocol.masks.dynamic else ()
    boxes = with_named_layers(training, None, {"boxes": arguments.boxes}, read=read).layers.boxes
    dataset = dataset.with_layers(boxes=boxes)
    task = ReconstructionTask(
        scene=scene,
        split=arguments.split,
        protocol=scaled,
        steps=arguments.steps if has_budget else defaults.steps,
        core_minutes=arguments.minutes if has_budget else defaults.core_minutes,
        seed=arguments.seed,
        initialise=arguments.initialise,
        blocks=frozenset(filter(None, (arguments.blocks or "").split(","))),
        threads=arguments.threads,
        half=arguments.fp16,
        settings=parse_settings(arguments.set),
        device=device.name,
        devices=tuple(one.name for one in devices) if len(devices) > 1 else (),
        executor=executor,
        withheld=list_withheld_images(training)
        | (list_scored_training_images(dataset, scaled, arguments.split, scene) if arguments.hold_out else frozenset()),
    )
    with progress_bar(quiet=arguments.json) as bar, naming_option(Path(arguments.dataset), "--layers FOLDER"):
        result = reconstruct(arguments.method, method, dataset, task, arguments.out, bar)
    if arguments.json:
        more = {"folder": str(result.folder), "scene": scene, "withheld": len(task.withheld), "device": device.name}
        print(json.dumps({**asdict(result), **more}))
    else:
        _print(result, scene, arguments)
    return ExitCode.DONE


def _choose_devices(arguments: Arguments, subject: str, capabilities: Capabilities) -> list[Device]:
    """Choose the devices that train: that of ``--device``, or those of ``--devices``.

    Raises:
        UsageError: both options are given, a device cannot be used, or the devices are of two kinds.
    """

    def choose(name: str) -> Device:
        return choose_device(name, subject, takes_device=capabilities.takes_device, splats=capabilities.rasterizes)

    if arguments.devices is None:
        return [choose(arguments.device)]
    if arguments.device != AUTO:
        raise UsageError("--device and --devices exclude each other", expected="one of them, or neither")
    names = [f"cuda:{name}" if name.isdecimal() else name for name in arguments.devices.split(",")]
    try:
        for name in names:
            require_device_name(name)
        devices = [choose(name) for name in names]
    except UsageError as error:
        error.place, error.remedy = f"--devices {arguments.devices}", f"{error.remedy}, in place of --devices"
        raise
    if len({one.is_cuda for one in devices}) > 1:
        raise UsageError(arguments.devices, place="--devices", expected="devices of one kind")
    return devices


def _scene(dataset: Dataset, split: str, requested: str | None) -> str:
    scenes = dataset.where(split=split, role="train").scenes()
    if requested is None and len(scenes) != 1:
        raise UsageError(
            f"{len(scenes)} scenes in split {split}", place="--scene", expected=f"one of {_listed(scenes)}"
        )
    if requested is not None and requested not in scenes:
        raise UsageError(f"no training traversals in scene {requested!r}", place="--scene", expected=_listed(scenes))
    return requested or scenes[0]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "a scene with training traversals"


def _print(result: ReconstructionResult, scene: str, arguments: Arguments) -> None:
    reached = [
        None if result.psnr_db is None else f"{result.psnr_db:.2f} dB on training images",
        None if result.steps is None else f"after {result.steps} steps",
    ]
    trained = [
        " ".join(filter(None, reached)) or "reconstructed",
        None if result.core_s is None else f"{result.core_s / 60.0:.1f} core-minutes",
        None if result.wall_s is None else f"{result.wall_s / 60.0:.1f} minutes",
    ]
    print(f"{scene}: {', '.join(filter(None, trained))}")
    counts = [
        count_of(len(result.blocks), "block") if result.blocks else None,
        None if result.pictures is None else f"{result.pictures} images",
        None if result.gaussians is None else f"{result.gaussians} Gaussians",
        f"{(result.model_bytes or 0) / 1e6:.2f} MB, {result.driven_m or 0.0:.0f} m of road",
    ]
    print(", ".join(filter(None, counts)))
    if result.points is not None:
        print(f"initialised from points {result.points}")
    print(f"model: {result.folder}")
    if result.undone:
        print(f"not trained yet: {', '.join(result.undone)}; when they are, run the same command without --blocks")
        return
    file = f" --method {arguments.method}" if is_file_reference(arguments.method) else ""
    split = f"--split {arguments.split}{_protocol_options(arguments)}{file}"
    if arguments.poses not in (None, "recorded"):
        # Protocols plan their views with recorded poses.
        print(f"next: mirror view {arguments.dataset} {result.folder}")
        return
    print(f"next: mirror render {arguments.dataset} {result.folder} {split} --out SUBMISSION")


def _protocol_options(arguments: Arguments) -> str:
    """The options that choose the same protocol again, with a space before each."""
    named = "" if arguments.protocol == Arguments.protocol else f" --protocol {arguments.protocol}"
    return named if arguments.masks else f"{named} --no-masks"
