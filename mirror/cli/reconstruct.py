"""``mirror reconstruct DATASET --scene S --split NAME --out MODEL``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset
    from mirror.methods.plugin import ReconstructionResult

_MINUTES = 10.0


@dataclass(frozen=True)
class Arguments:
    """Reconstruct the static street of a scene from the training traversals of a split.

    Run again, it goes on where it stopped; a done run is told of and left as it is. Ctrl-C leaves a checkpoint.
    """

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL; a local folder if layers of depth are to be made."""
    split: str
    """Name of the split; held-out traversals are not learnt from."""
    out: Path
    """Folder of the model: a new one, or that of the same run."""
    scene: str | None = None
    """Id of the scene. Default: the only one of the split."""
    method: str = "hybridworldsim"
    """An installed method (entry points mirror.methods)."""
    minutes: float | None = None
    """Processor time of training in each block, of all threads together. Default: 10, if there are no --steps."""
    steps: int | None = None
    """Pictures to train on in each block, in place of --minutes: repeats exactly at the same --threads."""
    width: int = 240
    """Pictures are scaled down to so many pixels."""
    protocol: str = "static-reconstruction"
    """Whose raster and masks hold: a name, or the path of its .toml."""
    hold_out: bool = False
    """Learn neither colours nor depth from what the protocol asks for of training traversals: these pictures are the
    test, where there is no other traversal."""
    seed: int = 0
    """Of all that is left to chance."""
    initialise: str | None = None
    """plane-sweep, mvsnet, patchmatchnet, sparse: makes layers of depth and points, if they are absent; dataset: the
    layers that were brought, or SOURCE@VERSION, one of them. Default: those that were brought where there are points
    and nothing is held out, else plane-sweep."""
    blocks: str | None = None
    """Names of blocks, separated by commas, to train these alone: others may be trained by other machines at the same
    time. Once all are, the same command without it finishes the model. Default: all."""
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A setting of the method in place of its own, NAME=VALUE, such as depth_weight=0.1 or refinement.max_anchors=9000;
    run.json of a block lists all."""
    threads: int | None = None
    """Default: as many as there are processors."""
    fp16: bool = False
    """Write the model in half precision (16-bit floats)."""
    json: bool = False
    """Print what came of it as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror reconstruct", renamed={"--half": "--fp16"})
    for name, number, least in (
        ("--minutes", arguments.minutes, 0.0),
        ("--steps", arguments.steps, 0.0),
        ("--threads", arguments.threads, 0.0),
        ("--width", arguments.width, 15.0),
    ):
        if number is not None and not number > least:
            raise UsageError(f"{number:g}", place=name, expected=f"more than {least:g}")
    if arguments.seed < 0:
        raise UsageError(f"{arguments.seed}", place="--seed", expected="0 or more")
    if arguments.minutes is not None and arguments.steps is not None:
        raise UsageError("both --minutes and --steps", expected="one of them")

    from mirror.methods.plugin import ReconstructionTask
    from mirror.methods.registry import installed_method

    method = installed_method(arguments.method)

    import mirror
    from mirror.methods.training_images import list_scored_training_images
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol

    dataset = mirror.open(arguments.dataset)
    protocol = load_protocol(arguments.protocol)
    narrow = protocol.model_copy(
        update={"pixels": protocol.pixels.model_copy(update={"max_width_px": arguments.width})}
    )
    scene = _scene(dataset, arguments.split, arguments.scene)
    minutes = _MINUTES if arguments.minutes is None and arguments.steps is None else arguments.minutes
    task = ReconstructionTask(
        scene=scene,
        split=arguments.split,
        protocol=narrow,
        steps=arguments.steps,
        core_minutes=minutes,
        seed=arguments.seed,
        initialise=arguments.initialise,
        blocks=frozenset(filter(None, (arguments.blocks or "").split(","))),
        threads=arguments.threads,
        half=arguments.fp16,
        settings=_settings(arguments.set),
        withheld=list_scored_training_images(dataset, narrow, arguments.split, scene)
        if arguments.hold_out
        else frozenset(),
    )
    with progress_bar(quiet=arguments.json) as watch:
        done = method.reconstruct(dataset, task, arguments.out, watch)
    if arguments.json:
        said = {"folder": str(done.folder), "scene": scene}
        print(json.dumps({**asdict(done), **said, "withheld": len(task.withheld)}))
    else:
        _print(done, scene, arguments)
    return ExitCode.DONE


def _scene(dataset: Dataset, split: str, wanted: str | None) -> str:
    scenes = dataset.where(split=split, role="train").scenes()
    if wanted is None and len(scenes) != 1:
        raise UsageError(
            f"{len(scenes)} scenes in split {split}", place="--scene", expected=f"one of {_listed(scenes)}"
        )
    if wanted is not None and wanted not in scenes:
        raise UsageError(f"no training traversals in scene {wanted!r}", place="--scene", expected=_listed(scenes))
    return wanted or scenes[0]


def _settings(words: Sequence[str]) -> dict[str, str]:
    bare = [word for word in words if not all(word.partition("="))]
    if bare:
        raise UsageError(f"{bare[0]!r}", place="--set", expected="NAME=VALUE")
    return {name: value for name, _, value in (word.partition("=") for word in words)}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "a scene with training traversals"


def _print(done: ReconstructionResult, scene: str, arguments: Arguments) -> None:
    print(
        f"{scene}: {done.psnr_db:.2f} dB on training pictures after {done.steps} steps, "
        f"{done.core_s / 60.0:.1f} core-minutes, {done.wall_s / 60.0:.1f} minutes"
    )
    print(
        f"{len(done.blocks)} block{'s' * (len(done.blocks) != 1)}, {done.pictures} pictures, "
        f"{done.gaussians} Gaussians, {done.model_bytes / 1e6:.2f} MB, {done.driven_m:.0f} m of road"
    )
    print(f"it began with {f'points {done.points}' if done.points else 'no layer of points'}")
    print(f"model: {done.folder}; of each block model.safetensors, curves.csv, curves.svg, pictures/, checkpoint")
    if done.undone:
        print(f"still to be trained: {', '.join(done.undone)}; then the same command without --blocks")
        return
    print(f"next: mirror render {done.folder} --dataset {arguments.dataset} --split {arguments.split} --out SUBMISSION")
