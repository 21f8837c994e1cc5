"""The command line of ``mirror generate``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
    from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
    from hybridworldsim.generation.scenes.released import ReleasedModel
    from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
    from mirror.dataset.dataset import Dataset

_SCENE_EXAMPLES = (
    "mirror generate scene demo/block/dataset generator --background demo/block/model --out generated",
    "mirror generate scene dataset generator --background exact:block --edit move:7:dy=1.5 --frames 20 --out moved",
)
_DISTIL_EXAMPLES = (
    "mirror generate distil clips generator --steps 2000 --out distilled",
    "mirror generate distil clips generator --steps 2000 --segments 2 --out two_steps",
)
_TRAIN_EXAMPLES = (
    "mirror generate train clips --steps 4000 --out generator",
    "mirror generate train clips --steps 4000 --no-background --autoencoder generator/autoencoder/model.safetensors "
    "--out without_background",
)


@dataclass(frozen=True)
class Train:
    """Train a generator of traffic on clips: images of a rig, the same views of the empty street, and boxes.

    An autoencoder is trained first, unless one is given. Ctrl-C leaves a checkpoint, and the same command continues; at
    the same number of threads the result is the same, bit for bit. `torchrun` starts several processes.
    """

    clips: tyro.conf.Positional[Path]
    """Folder of clips, with clips.json. `python -m benchmarks generation clips` makes one of the synthetic street."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or that of an interrupted run with the same options."""
    steps: int
    """Number of steps of the generator."""
    autoencoder: Annotated[Path | None, help_text(default="one is trained", metavar="FILE")] = None
    """A trained autoencoder: model.safetensors of an earlier run."""
    autoencoder_steps: int = 2000
    """Number of steps of the autoencoder."""
    captions: Annotated[Path | None, help_text(default="no text", metavar="FILE")] = None
    """Embedded captions: safetensors with NAME/tokens and NAME/pooled, where NAME is a clip, CLIP/CAMERA, a camera, or
    all. The network takes the width that they have."""
    background: bool = True
    """Whether the generator receives the images of the empty street."""
    map: bool = False
    """Whether the generator is shown lanes, the drivable area and crossings. Clips must have maps, such as those of
    `python -m benchmarks generation clips --map`."""
    weighting: Literal["velocity", "epsilon", "x0"] = "velocity"
    """Whose square error the loss is: that of the velocity, of the noise, or of the clean latents."""
    batch: int = 4
    """Windows of a step, over all processes."""
    accumulate: int = 1
    """Parts of a batch that are computed one after another, to save memory."""
    learning_rate: float = 1e-3
    """Highest learning rate. It rises in 100 steps, then falls to 0 behind the last step."""
    context_noise: float = 0.0
    """Highest noise level of the reference frames. It hides errors that add up in rollouts."""
    self_rollout: float = 0.0
    """Share of windows whose reference frames are the model's own output, so that it learns from its errors."""
    self_rollout_steps: int = 2
    """Steps of the sampler for such a reference frame."""
    drop_layout: float = 0.0
    """Share of windows without boxes and map, for guidance."""
    ema: float = 0.995
    """Highest decay of the averaged parameters, which are those of the model."""
    precision: Literal["float32", "bf16"] = "float32"
    """Precision of the network's computation."""
    recompute: bool = False
    """Compute activations again for the gradient, to save memory."""
    seed: int = 0
    """Seed of all random choices."""
    threads: int = 1
    """Number of threads."""
    device: str = "cpu"
    """Where the generator is trained: cpu, cuda, cuda:1."""
    json: bool = False
    """Print JSON."""

    @property
    def settings(self) -> GeneratorSettings:
        """The settings of the training."""
        from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
        from hybridworldsim.generation.training.run import with_map, with_text_of, without_background

        settings = GeneratorSettings(
            weighting=self.weighting,
            batch=self.batch,
            accumulate=self.accumulate,
            learning_rate=self.learning_rate,
            context_noise=self.context_noise,
            self_rollout=self.self_rollout,
            self_rollout_steps=self.self_rollout_steps,
            drop_layout=self.drop_layout,
            ema=self.ema,
            precision=self.precision,
            recompute=self.recompute,
        )
        settings = with_map(settings) if self.map else settings
        if self.captions is not None:
            settings = with_text_of(settings, self.captions)
        return settings if self.background else without_background(settings)


@dataclass(frozen=True)
class Distil:
    """Distil a trained generator to few steps, without guidance: its student jumps where the teacher walks.

    Ctrl-C leaves a checkpoint, and the same command continues; at the same number of threads the result is the same,
    bit for bit. `torchrun` starts several processes.
    """

    clips: tyro.conf.Positional[Path]
    """Folder of clips, with clips.json: those of the training."""
    generator: tyro.conf.Positional[Path]
    """Folder that `mirror generate train` wrote, or model.safetensors of a generator."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or that of an interrupted run with the same options."""
    steps: int
    """Number of steps of the training."""
    segments: int = 4
    """Steps of the sampler that the student is made for."""
    teacher_steps: int = 32
    """Small steps of the teacher, a multiple of --segments."""
    autoencoder: Annotated[Path | None, help_text(default="beside the generator", metavar="FILE")] = None
    """Autoencoder that the generator was trained with."""
    captions: Annotated[Path | None, help_text(default="no text", metavar="FILE")] = None
    """Embedded captions, for a generator that was trained with such."""
    batch: int = 4
    """Windows of a step, over all processes."""
    learning_rate: float = 2e-4
    """Highest learning rate. It rises in 100 steps, then falls to 0 behind the last step."""
    ema: float = 0.995
    """Highest decay of the averaged parameters, which are the student's targets and those of the model."""
    accumulate: int = 1
    """Parts of a batch that are computed one after another, to save memory."""
    precision: Literal["float32", "bf16"] = "float32"
    """Precision of the networks' computation."""
    recompute: bool = False
    """Compute activations again for the gradient, to save memory."""
    seed: int = 0
    """Seed of all random choices."""
    threads: int = 1
    """Number of threads."""
    device: str = "cpu"
    """Where the student is trained: cpu, cuda, cuda:1."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Scene:
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
    device: str = "cpu"
    """Where the generator runs: cpu, cuda, cuda:1. Backgrounds are rendered on the processor."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "train": Subcommand("train a generator on a folder of clips", _train),
        "distil": Subcommand("distil a trained generator to few steps", _distil),
        "scene": Subcommand("generate the road users of a scene over its static street", _scene),
    }
    return run_subcommand(argv, "mirror generate", subcommands)


def _train(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Train, argv, "mirror generate train", examples=_TRAIN_EXAMPLES)

    from hybridworldsim.generation.training.processes import leads_process
    from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
    from mirror.progress import progress_bar

    options = TrainingOptions(
        steps=arguments.steps,
        autoencoder_steps=arguments.autoencoder_steps,
        autoencoder=arguments.autoencoder,
        captions=arguments.captions,
        settings=arguments.settings,
        seed=arguments.seed,
        threads=arguments.threads,
        device=arguments.device,
    )
    with progress_bar(quiet=arguments.json or not leads_process()) as bar:
        result = train_on_clips(arguments.clips, arguments.out, options, bar)
    if not leads_process():
        return ExitCode.DONE
    outcome = result.generator_outcome
    bound = None if result.autoencoder_outcome is None else result.autoencoder_outcome.psnr_db
    if arguments.json:
        document = {
            "generator": str(result.generator),
            "autoencoder": str(result.autoencoder),
            "autoencoder_psnr_db": bound,
            **outcome.model_dump(exclude={"psnr_db"}),
        }
        print(json.dumps(document))
        return ExitCode.DONE
    print(
        f"{result.generator}: {outcome.steps} steps, {outcome.core_s / 60.0:.1f} core-minutes, loss {outcome.loss:.5f}"
    )
    if bound is not None:
        print(f"{result.autoencoder}: {bound:.2f} dB on its training images, which bounds what is generated")
    return ExitCode.DONE


def _distil(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Distil, argv, "mirror generate distil", examples=_DISTIL_EXAMPLES)

    from hybridworldsim.generation.training.distillation import DistillationSettings
    from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
    from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
    from hybridworldsim.generation.training.processes import leads_process
    from mirror.progress import progress_bar

    generator, autoencoder = _model_files(arguments.generator, arguments.autoencoder)
    options = DistillationOptions(
        steps=arguments.steps,
        distillation=DistillationSettings(arguments.segments, arguments.teacher_steps),
        settings=GeneratorSettings(
            batch=arguments.batch,
            learning_rate=arguments.learning_rate,
            ema=arguments.ema,
            accumulate=arguments.accumulate,
            precision=arguments.precision,
            recompute=arguments.recompute,
        ),
        captions=arguments.captions,
        seed=arguments.seed,
        threads=arguments.threads,
        device=arguments.device,
    )
    with progress_bar(quiet=arguments.json or not leads_process()) as bar:
        model, outcome = distil_on_clips(arguments.clips, generator, autoencoder, arguments.out, options, bar)
    if not leads_process():
        return ExitCode.DONE
    if arguments.json:
        print(json.dumps({"generator": str(model), **outcome.model_dump(exclude={"psnr_db"})}))
        return ExitCode.DONE
    print(f"{model}: {outcome.steps} steps, {outcome.core_s / 60.0:.1f} core-minutes, loss {outcome.loss:.5f}")
    print(f"next: mirror generate scene DATASET {model} --autoencoder {autoencoder} --steps {arguments.segments} ...")
    return ExitCode.DONE


def _scene(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Scene, argv, "mirror generate scene", examples=_SCENE_EXAMPLES)
    for option in ("scene", "traversal", "trajectory", "cameras", "hz", "frames"):
        if arguments.split is not None and getattr(arguments, option) is not None:
            raise UsageError("the protocol decides it", place=f"--{option}", expected="no such option beside --split")
    if arguments.split is not None and arguments.edit:
        raise UsageError("the protocol decides it", place="--edit", expected="no such option beside --split")

    import mirror
    from hybridworldsim.generation.devices import GENERATION_REMEDY, exhausted_memory_named
    from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
    from mirror.annotation.box_layer import with_box_layer

    dataset = with_box_layer(mirror.open(arguments.dataset), arguments.boxes)
    base = _base(arguments)
    sampler = _sampler(arguments, base)
    rollout = ClipRolloutOptions(sampler, arguments.keep_empty_views, _blend_px(arguments.blend), arguments.seed)
    if base is None or arguments.vae is None:
        generator, autoencoder = _model_files(arguments.generator, arguments.autoencoder)
    else:
        generator, autoencoder = arguments.generator, arguments.vae
    if arguments.split is not None:
        return _scene_submission(arguments, dataset, generator, autoencoder, rollout, arguments.split, base)

    from hybridworldsim.generation.scenes.released import NO_BACKGROUND
    from hybridworldsim.generation.scenes.run import SceneRequest, describe, generate_scene
    from mirror.progress import progress_bar

    request = SceneRequest(
        generator,
        autoencoder,
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
        base=base,
        captions=arguments.captions,
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


def _scene_submission(
    arguments: Scene,
    dataset: Dataset,
    generator: Path,
    autoencoder: Path,
    rollout: ClipRolloutOptions,
    split: str,
    base: ReleasedModel | None,
) -> int:
    from hybridworldsim.generation.devices import GENERATION_REMEDY, exhausted_memory_named
    from hybridworldsim.generation.scenes.released import NO_BACKGROUND
    from hybridworldsim.generation.scenes.submission import SubmissionRequest, generate_submission
    from mirror.progress import progress_bar

    request = SubmissionRequest(
        generator,
        autoencoder,
        arguments.protocol,
        split,
        arguments.background,
        arguments.appearance,
        _size(arguments.size, base),
        rollout,
        arguments.threads,
        arguments.device,
        base,
        arguments.captions,
    )
    with progress_bar(quiet=arguments.json) as bar, exhausted_memory_named(arguments.device, GENERATION_REMEDY):
        count = generate_submission(dataset, request, arguments.out, bar)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), "views": count}))
    else:
        print(f"{count} views: {arguments.out}")
        if base is not None:
            print(f"note: {NO_BACKGROUND}")
        print(f"next: mirror evaluate {arguments.dataset} {arguments.out}")
    return ExitCode.DONE


def _base(arguments: Scene) -> ReleasedModel | None:
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


def _sampler(arguments: Scene, base: ReleasedModel | None) -> SamplerSettings:
    from hybridworldsim.generation.inference.frame_sampler import SamplerSettings

    plain = SamplerSettings() if base is None else SamplerSettings(base.steps, base.shift, base.guidance)
    return replace(
        plain,
        steps=plain.steps if arguments.steps is None else arguments.steps,
        guidance=plain.guidance if arguments.guidance is None else arguments.guidance,
        precision=arguments.precision,
    )


def _model_files(generator: Path, autoencoder: Path | None) -> tuple[Path, Path]:
    """The files of a generator and its autoencoder, from a folder of `mirror generate train` or from files."""
    name = "model.safetensors"
    inner = generator / "generator" / name
    file = inner if inner.is_file() else generator / name if generator.is_dir() else generator
    beside = autoencoder or file.parent.parent / "autoencoder" / name
    for path, place in ((file, "GENERATOR"), (beside, "--autoencoder")):
        if not path.is_file():
            raise UsageError(
                "no such file", file=path, place=place, expected="a model that `mirror generate train` wrote"
            )
    return file, beside


def _only_scene(dataset: Dataset) -> str:
    scenes = dataset.scenes()
    if len(scenes) != 1:
        raise UsageError(f"{len(scenes)} scenes", place="--scene", expected=f"one of {', '.join(scenes)}")
    return scenes[0]


def _size(text: str | None, base: ReleasedModel | None) -> tuple[int, int]:
    if text is None:
        return (64, 96) if base is None else base.size_px
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise UsageError(f"{text!r}", place="--size", expected="WIDTHxHEIGHT, such as 96x64")
    return int(height), int(width)


def _blend_px(text: str) -> int | None:
    if text == "none":
        return None
    if not text.isdecimal():
        raise UsageError(f"{text!r}", place="--blend", expected="pixels, such as 4, or none")
    return int(text)
