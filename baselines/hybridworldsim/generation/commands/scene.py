"""``mirror generate scene``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from hybridworldsim.generation.commands.model_paths import find_model_files
from mirror.command_line import help_text, parse_arguments
from mirror.devices import resolve_device
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
    from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
    from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
    from hybridworldsim.generation.scenes.released import ReleasedModel
    from mirror.dataset.dataset import Dataset

_EXAMPLES = (
    "mirror generate scene demo/block/dataset generator --background demo/block/model --out generated",
    "mirror generate scene dataset generator --background exact:block --edit move:7:dy=1.5 --frames 20 --out moved",
)


@dataclass(frozen=True)
class SceneArguments:
    """Generate the road users of a scene over its static street: frames and a video, or a submission.

    Without --split, the first five frames at --hz seed the rollout and are not output. With --split, every view that a
    protocol asks for is generated, and backgrounds seed the rollout. The same command continues an interrupted run.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset: it has boxes, poses, lenses, and the images of the seeds."""
    generator: tyro.conf.Positional[Path]
    """Folder that `mirror generate train` wrote, or model.safetensors of a generator; with --base a released state
    dict."""
    background: Annotated[str, help_text(metavar="MODEL|exact:PRESET[:SEED]|files:FOLDER")]
    """The static street: a model that `mirror reconstruct` wrote, the exact synthetic street, or
    <camera>/<timestamp_ns>.png."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or that of an interrupted run with the same options."""
    scene: Annotated[str | None, help_text(default="the only scene of the dataset", metavar="ID")] = None
    """Scene."""
    traversal: Annotated[str | None, help_text(default="the first of the scene", metavar="ID")] = None
    """Traversal that gives boxes, cameras and seeds."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes: labels of people, or of a version of an annotator."""
    trajectory: Annotated[str | None, help_text(default="the recorded line")] = None
    """Line of the vehicle in the generated frames: lane-shift:METRES, forward:METRES, a traversal, or a file."""
    edit: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="EDIT")] = ()
    """move:TRACK:dx=METRES,dy=METRES, remove:TRACK, or add:CLASS:at=X,Y,HEADING_DEG in the world frame."""
    appearance: str = "nearest"
    """Appearance of a static model: nearest, mean, a traversal, or a word such as night."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of a static model's method, if that is not installed: that of the training."""
    split: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """Split to write a submission for."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "generation"
    """Protocol of the submission: generation, vehicle-translation, editing-accuracy, its variant for small images
    editing-accuracy-small, or a .toml file."""
    cameras: Annotated[str | None, help_text(default="all of the rig", metavar="NAME,...")] = None
    """Cameras, without --split."""
    size: Annotated[str | None, help_text(default="96x64; 448x256 with --base", metavar="WIDTHxHEIGHT")] = None
    """Raster of generated images: that of the training."""
    hz: Annotated[float | None, help_text(default="that of the training, or the recording's if that is lower")] = None
    """Frames per second, without --split. Released models (--base) were trained at 10."""
    frames: Annotated[int | None, help_text(default="all")] = None
    """Largest number of generated frames, without --split."""
    autoencoder: Annotated[Path | None, help_text(default="beside the generator", metavar="FILE")] = None
    """Autoencoder that the generator was trained with."""
    base: Annotated[str | None, help_text(default="none", metavar="ctsd-35|unimlvg")] = None
    """Released model of OpenDWM whose state dict GENERATOR is. It does not follow the background."""
    vae: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """With --base: folder `vae` of the Stable Diffusion pipeline that the released model was trained on."""
    captions: Annotated[Path | None, help_text(default="no text", metavar="FILE")] = None
    """Embedded captions: safetensors with NAME/tokens and NAME/pooled, where NAME is a camera, or all. For released
    models, and for generators that were trained with captions."""
    steps: Annotated[int | None, help_text(default="4; with --base its own")] = None
    """Steps of the sampler."""
    guidance: Annotated[float | None, help_text(default="1; with --base its own")] = None
    """Scale of guidance by boxes: above 1 they are followed more closely, at twice the cost. For a generator that was
    trained with --drop-layout."""
    precision: Literal["float32", "bf16"] = "float32"
    """Precision of the network's computation."""
    keep_empty_views: bool = True
    """Whether a view without a road user keeps its background, at no cost."""
    blend: Annotated[str, help_text(metavar="PIXELS|none")] = "4"
    """Use generated pixels only in the hulls of boxes, grown by this many pixels of --size and with a soft edge of
    twice as many; elsewhere a view keeps its background. none: use them everywhere."""
    seed: int = 0
    """Seed of the noise."""
    threads: int = 1
    """Number of threads. Results repeat bit for bit at the same number."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that runs the generator. auto: a GPU that torch can use, else the CPU. The first line says which.
    Backgrounds are rendered on the CPU."""
    json: bool = False
    """Print JSON."""


def run_scene(argv: Sequence[str]) -> int:
    """Generate the road users of a scene, or of all views of a submission."""
    arguments = parse_arguments(SceneArguments, argv, "mirror generate scene", examples=_EXAMPLES)
    for option in ("scene", "traversal", "trajectory", "cameras", "hz", "frames"):
        if arguments.split is not None and getattr(arguments, option) is not None:
            raise UsageError("the protocol decides it", place=f"--{option}", expected="no such option beside --split")
    if arguments.split is not None and arguments.edit:
        raise UsageError("the protocol decides it", place="--edit", expected="no such option beside --split")

    import mirror
    from hybridworldsim.generation.devices import GENERATION_REMEDY
    from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
    from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
    from hybridworldsim.training.run.exhaustion import exhausted_memory_named
    from mirror.annotation.box_layer import with_box_layer

    device = resolve_device(arguments.device)
    if not arguments.json:
        print(device, flush=True)
    arguments = replace(arguments, device=device.name)
    dataset = with_box_layer(mirror.open(arguments.dataset), arguments.boxes)
    base = _base(arguments)
    sampler = _sampler(arguments, base)
    rollout = ClipRolloutOptions(sampler, arguments.keep_empty_views, parse_blend(arguments.blend), arguments.seed)
    if base is None or arguments.vae is None:
        generator, autoencoder = find_model_files(arguments.generator, arguments.autoencoder)
    else:
        generator, autoencoder = arguments.generator, arguments.vae
    files = GeneratorFiles(generator, autoencoder, base, arguments.captions)
    if arguments.split is not None:
        return _write_submission(arguments, dataset, files, rollout, arguments.split)

    from hybridworldsim.generation.scenes.released import NO_BACKGROUND
    from hybridworldsim.generation.scenes.run import SceneRequest, describe, generate_scene
    from mirror.progress import progress_bar

    request = SceneRequest(
        files,
        arguments.scene or _only_scene(dataset),
        arguments.background,
        traversal=arguments.traversal,
        trajectory=arguments.trajectory,
        edits=arguments.edit,
        appearance=arguments.appearance,
        cameras=None if arguments.cameras is None else tuple(arguments.cameras.split(",")),
        size_px=_size(arguments.size, base),
        hz=arguments.hz,
        frames=arguments.frames,
        rollout=rollout,
        threads=arguments.threads,
        device=arguments.device,
        method_file=arguments.method,
    )
    with progress_bar(quiet=arguments.json) as bar, exhausted_memory_named(arguments.device, GENERATION_REMEDY):
        document = generate_scene(dataset, request, arguments.out, bar)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **document.model_dump()}))
    else:
        print(f"{arguments.out}: {describe(document)}")
        if base is not None:
            print(f"note: {NO_BACKGROUND}")
        print(f"video: {arguments.out / 'video.mp4'}")
    return ExitCode.DONE


def _write_submission(
    arguments: SceneArguments, dataset: Dataset, files: GeneratorFiles, rollout: ClipRolloutOptions, split: str
) -> int:
    from hybridworldsim.generation.devices import GENERATION_REMEDY
    from hybridworldsim.generation.scenes.released import NO_BACKGROUND
    from hybridworldsim.generation.scenes.submission import SubmissionRequest, generate_submission
    from hybridworldsim.training.run.exhaustion import exhausted_memory_named
    from mirror.progress import progress_bar
    from mirror.protocols.document import format_file_option

    request = SubmissionRequest(
        files,
        arguments.protocol,
        split,
        arguments.background,
        arguments.appearance,
        _size(arguments.size, files.base),
        rollout,
        arguments.threads,
        arguments.device,
        arguments.method,
    )
    with progress_bar(quiet=arguments.json) as bar, exhausted_memory_named(arguments.device, GENERATION_REMEDY):
        count = generate_submission(dataset, request, arguments.out, bar)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), "views": count}))
    else:
        print(f"{count} views: {arguments.out}")
        if files.base is not None:
            print(f"note: {NO_BACKGROUND}")
        print(f"next: mirror evaluate {arguments.dataset} {arguments.out}{format_file_option(arguments.protocol)}")
    return ExitCode.DONE


def _base(arguments: SceneArguments) -> ReleasedModel | None:
    from hybridworldsim.generation.scenes.released import released_model

    if arguments.base is None:
        if arguments.vae is not None:
            raise UsageError("an autoencoder of a released model", place="--vae", expected="--base beside it")
        return None
    base = released_model(arguments.base)
    if arguments.autoencoder is not None:
        raise UsageError("a released model", place="--autoencoder", expected="--vae FOLDER in its place")
    if arguments.vae is None:
        raise UsageError(
            "no autoencoder", place="--vae", expected="folder `vae` of the Stable Diffusion pipeline of the base"
        )
    return base


def _sampler(arguments: SceneArguments, base: ReleasedModel | None) -> SamplerSettings:
    from hybridworldsim.generation.inference.frame_sampler import SamplerSettings

    plain = SamplerSettings() if base is None else SamplerSettings(base.steps, base.shift, base.guidance)
    return replace(
        plain,
        steps=plain.steps if arguments.steps is None else arguments.steps,
        guidance=plain.guidance if arguments.guidance is None else arguments.guidance,
        precision=arguments.precision,
    )


def _only_scene(dataset: Dataset) -> str:
    scenes = dataset.scenes()
    if len(scenes) != 1:
        raise UsageError(f"{len(scenes)} scenes", place="--scene", expected=f"one of {', '.join(scenes)}")
    return scenes[0]


def _size(text: str | None, base: ReleasedModel | None) -> tuple[int, int]:
    if text is None:
        return (64, 96) if base is None else base.size_px
    return parse_size(text)


def parse_size(text: str) -> tuple[int, int]:
    """Parse a size WIDTHxHEIGHT in pixels; returns height and width.

    Raises:
        UsageError: the text has another form.
    """
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise UsageError(f"{text!r}", place="--size", expected="WIDTHxHEIGHT, such as 96x64")
    return int(height), int(width)


def parse_blend(text: str) -> int | None:
    """Read the pixels by which hulls of boxes are grown; None: generated pixels are used everywhere.

    Raises:
        UsageError: the text is neither a number nor ``none``.
    """
    if text == "none":
        return None
    if not text.isdecimal():
        raise UsageError(f"{text!r}", place="--blend", expected="pixels, such as 4, or none")
    return int(text)
