"""``mirror generate distil``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from hybridworldsim.generation.commands.model_paths import describe_training, find_model_files
from mirror.command_line import help_text, parse_arguments
from mirror.devices import resolve_device
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror generate distil clips generator --steps 2000 --out distilled",
    "mirror generate distil clips generator --steps 2000 --segments 2 --out two_steps",
)


@dataclass(frozen=True)
class Distil:
    """Distil a trained generator to a student that samples in few steps, without guidance.

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
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that trains the student. auto: a GPU that torch can use, else the CPU. The first line says which."""
    json: bool = False
    """Print JSON."""


def run_distil(argv: Sequence[str]) -> int:
    """Distil a trained generator to one that samples in few steps."""
    arguments = parse_arguments(Distil, argv, "mirror generate distil", examples=_EXAMPLES)

    from hybridworldsim.generation.training.distillation import DistillationSettings
    from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
    from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
    from hybridworldsim.training.run.processes import leads_process
    from mirror.progress import progress_bar

    generator, autoencoder = find_model_files(arguments.generator, arguments.autoencoder)
    device = resolve_device(arguments.device)
    if not arguments.json and leads_process():
        print(device, flush=True)
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
        device=device.name,
    )
    with progress_bar(quiet=arguments.json or not leads_process()) as bar:
        model, outcome = distil_on_clips(arguments.clips, generator, autoencoder, arguments.out, options, bar)
    if not leads_process():
        return ExitCode.DONE
    if arguments.json:
        print(json.dumps({"generator": str(model), **outcome.model_dump(exclude={"psnr_db"})}))
        return ExitCode.DONE
    print(describe_training(model, outcome))
    print(f"next: mirror generate scene DATASET {model} --autoencoder {autoencoder} --steps {arguments.segments} ...")
    return ExitCode.DONE
