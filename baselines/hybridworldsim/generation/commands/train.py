"""``mirror generate train``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from hybridworldsim.generation.commands.model_paths import describe_training
from mirror.command_line import help_text, parse_arguments
from mirror.devices import resolve_device
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from hybridworldsim.generation.training.generator_trainer import GeneratorSettings

_EXAMPLES = (
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
    """Folder of clips, with clips.json, as `mirror generate clips` makes one of a dataset."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or that of an interrupted run with the same options."""
    steps: int
    """Number of steps of the generator."""
    autoencoder: Annotated[Path | None, help_text(default="one is trained", metavar="FILE")] = None
    """A trained autoencoder: model.safetensors of an earlier run."""
    autoencoder_steps: int = 2000
    """Number of steps of the autoencoder."""
    preset: Literal["tiny", "small"] = "tiny"
    """Size of the network. tiny: 6.6 million parameters, for images of a hundred pixels, trained on one core.
    small: 63 million, for images of 448 x 256 (mirror generate clips --size 448x256), trained on a GPU."""
    captions: Annotated[Path | None, help_text(default="no text", metavar="FILE")] = None
    """Embedded captions: safetensors with NAME/tokens and NAME/pooled, where NAME is a clip, CLIP/CAMERA, a camera, or
    all. The network takes the width that they have."""
    background: bool = True
    """Whether the generator receives the images of the empty street."""
    map: bool = False
    """Whether the generator is shown lanes, the drivable area and crossings. Clips must have maps, such as those of a
    dataset with a recorded map."""
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
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that trains the generator. auto: a GPU that torch can use, else the CPU. The first line says which."""
    json: bool = False
    """Print JSON."""

    @property
    def settings(self) -> GeneratorSettings:
        """The settings of the training."""
        from hybridworldsim.generation.network.configuration import SIZES
        from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
        from hybridworldsim.generation.training.run import with_map, with_text_of, without_background

        settings = GeneratorSettings(
            network=SIZES[self.preset],
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


def run_train(argv: Sequence[str]) -> int:
    """Train a generator on a folder of clips."""
    arguments = parse_arguments(Train, argv, "mirror generate train", examples=_EXAMPLES)

    from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
    from hybridworldsim.training.run.processes import leads_process
    from mirror.progress import progress_bar

    device = resolve_device(arguments.device)
    if not arguments.json and leads_process():
        print(device, flush=True)
    options = TrainingOptions(
        steps=arguments.steps,
        autoencoder_steps=arguments.autoencoder_steps,
        autoencoder=arguments.autoencoder,
        captions=arguments.captions,
        settings=arguments.settings,
        seed=arguments.seed,
        threads=arguments.threads,
        device=device.name,
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
    print(describe_training(result.generator, outcome))
    if bound is not None:
        print(f"{result.autoencoder}: {bound:.2f} dB on its training images, which bounds what is generated")
    return ExitCode.DONE
