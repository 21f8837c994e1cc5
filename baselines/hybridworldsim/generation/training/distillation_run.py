"""Distils a generator on a folder of clips; an interrupted run continues."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from hybridworldsim.generation.clips.folder import ClipFiles, read_list
from hybridworldsim.generation.devices import (
    TRAINING_REMEDY,
    repeating_exactly,
    require_counts,
    require_seed,
)
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.model_files import captioned_config, read_autoencoder, read_generator, write_generator
from hybridworldsim.generation.training.distillation import DistillationSettings, DistillationTrainer
from hybridworldsim.generation.training.documents import GenerationOutcome, GenerationRun
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from hybridworldsim.generation.training.numbered import numbered_training
from hybridworldsim.generation.training.run import captions_document, hash_clips, rates_of, read_clip_captions
from hybridworldsim.generation.training.samples import write_samples
from hybridworldsim.generation.training.windows import ClipWindows, require_clips, require_fit, require_maps
from hybridworldsim.training.run.document import describe_computation
from hybridworldsim.training.run.exhaustion import exhausted_memory_named
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import train
from hybridworldsim.training.run.processes import join_processes
from mirror.devices import resolve_device
from mirror.errors import DatasetError
from mirror.progress import ProgressReporter
from mirror.weights.resolve import file_sha256

_LOSS = "velocity"


@dataclass(frozen=True)
class DistillationOptions:
    """Options of a distillation run.

    Attributes:
        steps: steps of the student's training.
        distillation: segments and steps of the teacher.
        settings: how steps are made; the network is the teacher's.
        seed: seed of all random numbers.
        threads: number of torch threads.
        device: where the networks are.
        captions: file of embedded captions, for a teacher that was trained with such; None: no text.
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
    """

    steps: int
    distillation: DistillationSettings = field(default_factory=DistillationSettings)
    settings: GeneratorSettings = field(default_factory=lambda: GeneratorSettings(learning_rate=2e-4))
    seed: int = 0
    threads: int = 1
    device: str = "cpu"
    captions: Path | None = None
    checkpoint_s: float = 60.0

    def __post_init__(self) -> None:
        require_counts(steps=self.steps, threads=self.threads)
        require_seed(self.seed)


def distil_on_clips(
    clips: Path,
    generator: Path,
    autoencoder: Path,
    out: Path,
    options: DistillationOptions,
    reporter: ProgressReporter,
) -> tuple[Path, GenerationOutcome]:
    """Distil a generator on the training clips of a folder.

    Args:
        clips: the folder of clips.
        generator: file of the teacher.
        autoencoder: file of its autoencoder.
        out: folder of the run; another call with the same options continues.
        options: see `DistillationOptions`.
        reporter: receives the progress.

    Returns:
        The file of the student, and the outcome of the run.

    Raises:
        DatasetError: clips or models are missing or broken, the loss is not finite, or memory is exhausted.
        UsageError: `out` holds another run, or the models or the captions do not fit.
        WeightsUnavailableError: the captions are missing, broken or of another size.
    """
    options = replace(options, device=resolve_device(options.device).name)
    torch.set_num_threads(options.threads)
    listed = read_list(clips).training
    if not listed:
        raise DatasetError("no training clips", file=clips, expected="at least one clip")
    if options.captions is not None:
        captioned_config(generator)
    teacher, references = read_generator(generator)
    codec = read_autoencoder(autoencoder)
    require_fit(codec, teacher.config, OWN_STYLE, references, file=autoencoder)
    clips_hash = hash_clips(clips, listed)
    loaded = ClipFiles(clips, listed)
    require_clips(loaded.headers, teacher.config, references, clips)
    without_map = require_maps(loaded.headers, teacher.config, OWN_STYLE, clips)
    if without_map is not None:
        reporter.message(without_map)
    captions = read_clip_captions(options.captions, teacher.config, loaded.headers)
    settings = replace(options.settings, network=teacher.config, references=references)
    with (
        exhausted_memory_named(options.device, TRAINING_REMEDY),
        repeating_exactly(options.device),
        join_processes(options.device) as processes,
    ):
        settings.require_shares(processes.count)
        folder = RunFolder(out, GenerationOutcome, processes)
        document = {
            **settings.document,
            "distillation": options.distillation.document,
            "teacher": file_sha256(generator),
            **captions_document(options.captions),
        }
        run = GenerationRun(
            part="distilled", settings=document, seed=options.seed, steps=options.steps, threads=options.threads,
            processes=processes.count, clips_hash=clips_hash, autoencoder_hash=file_sha256(autoencoder),
            computed=describe_computation(options.device, settings.precision),
        )  # fmt: skip
        outcome = folder.begin(run)
        if outcome is not None:
            return folder.model, outcome
        windows = ClipWindows(loaded, codec, teacher.config, OWN_STYLE, references, captions)
        trainer = DistillationTrainer(
            settings, options.distillation, teacher, windows, options.steps, seed=options.seed, device=processes.device,
            rank=processes.rank, processes=processes.count,
        )  # fmt: skip

        def sample(step: int) -> None:
            write_samples(
                out / "samples", f"{step:08d}", trainer.averaged_network, windows, codec, device=processes.device,
                steps=options.distillation.segments,
            )  # fmt: skip

        training = numbered_training(
            trainer, options.steps,
            lambda file: write_generator(
                file, trainer.averaged_network(), references, rates_hz=rates_of(loaded.headers),
                captions=captions is not None,
            ),
            phase="distillation", loss=_LOSS, checkpoint_s=options.checkpoint_s, sample=sample,
        )  # fmt: skip
        with folder.claim(run):
            return folder.model, train(training, folder, reporter)
