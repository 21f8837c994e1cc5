"""The command line of ``mirror generate``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from hybridworldsim.generation.training.generator_trainer import GeneratorSettings

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
    background: bool = True
    """Whether the generator receives the images of the empty street."""
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
    drop_layout: float = 0.0
    """Share of windows without boxes, for guidance."""
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
        from hybridworldsim.generation.training.run import without_background

        settings = GeneratorSettings(
            weighting=self.weighting,
            batch=self.batch,
            accumulate=self.accumulate,
            learning_rate=self.learning_rate,
            context_noise=self.context_noise,
            drop_layout=self.drop_layout,
            ema=self.ema,
            precision=self.precision,
            recompute=self.recompute,
        )
        return settings if self.background else without_background(settings)


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    return run_subcommand(
        argv, "mirror generate", {"train": Subcommand("train a generator on a folder of clips", _train)}
    )


def _train(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Train, argv, "mirror generate train", examples=_TRAIN_EXAMPLES)

    from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
    from mirror.progress import progress_bar

    options = TrainingOptions(
        steps=arguments.steps,
        autoencoder_steps=arguments.autoencoder_steps,
        autoencoder=arguments.autoencoder,
        settings=arguments.settings,
        seed=arguments.seed,
        threads=arguments.threads,
        device=arguments.device,
    )
    with progress_bar(quiet=arguments.json) as bar:
        result = train_on_clips(arguments.clips, arguments.out, options, bar)
    outcome = result.generator_outcome
    if arguments.json:
        document = {
            "generator": str(result.generator),
            "autoencoder": str(result.autoencoder),
            **outcome.model_dump(exclude={"psnr_db"}),
        }
        print(json.dumps(document))
        return ExitCode.DONE
    print(
        f"{result.generator}: {outcome.steps} steps, {outcome.core_s / 60.0:.1f} core-minutes, loss {outcome.loss:.5f}"
    )
    if result.autoencoder_outcome is not None:
        bound = result.autoencoder_outcome.psnr_db
        print(f"{result.autoencoder}: {bound:.2f} dB on its training images, which bounds what is generated")
    return ExitCode.DONE
