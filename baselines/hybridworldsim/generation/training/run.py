"""Trains an autoencoder and a generator on a folder of clips; both continue where they stopped."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from hybridworldsim.generation.autoencoder.codec import LatentCodec
from hybridworldsim.generation.clips.captions import CachedCaptions, embedding_widths
from hybridworldsim.generation.clips.folder import ClipFiles, ClipHeader, clip_path, read_list
from hybridworldsim.generation.devices import (
    TRAINING_REMEDY,
    repeating_exactly,
    require_counts,
    require_seed,
)
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.layout.map_lines import MAP_CHANNELS
from hybridworldsim.generation.model_files import read_autoencoder, write_autoencoder, write_generator
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.training.autoencoder_trainer import (
    AutoencoderSettings,
    AutoencoderTrainer,
    reconstruction_psnr_db,
)
from hybridworldsim.generation.training.clip_images import ClipImages
from hybridworldsim.generation.training.costs import count_costs, measure_speed
from hybridworldsim.generation.training.documents import GenerationOutcome, GenerationRun
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, GeneratorTrainer
from hybridworldsim.generation.training.numbered import numbered_training
from hybridworldsim.generation.training.samples import write_samples
from hybridworldsim.generation.training.windows import ClipWindows, require_clips, require_fit, require_maps
from hybridworldsim.training.run.document import describe_computation
from hybridworldsim.training.run.exhaustion import exhausted_memory_named
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import train
from hybridworldsim.training.run.processes import Processes, join_processes
from mirror.devices import CPU, require_memory, resolve_device
from mirror.errors import DatasetError, UsageError
from mirror.progress import ProgressReporter
from mirror.weights.resolve import file_sha256


@dataclass(frozen=True)
class TrainingOptions:
    """Options of a training run.

    Attributes:
        steps: steps of the generator.
        autoencoder_steps: steps of the autoencoder.
        autoencoder: file of a trained autoencoder; None: one is trained first.
        settings: how the generator is trained.
        autoencoder_settings: how the autoencoder is trained.
        seed: seed of all random numbers.
        threads: number of torch threads.
        device: where the generator is trained.
        captions: file of embedded captions, see `CachedCaptions`; None: no text.
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
    """

    steps: int
    autoencoder_steps: int = 2000
    autoencoder: Path | None = None
    settings: GeneratorSettings = field(default_factory=GeneratorSettings)
    autoencoder_settings: AutoencoderSettings = field(default_factory=AutoencoderSettings)
    seed: int = 0
    threads: int = 1
    device: str = "cpu"
    captions: Path | None = None
    checkpoint_s: float = 60.0

    def __post_init__(self) -> None:
        require_counts(steps=self.steps, autoencoder_steps=self.autoencoder_steps, threads=self.threads)
        require_seed(self.seed)


@dataclass(frozen=True)
class TrainingResult:
    """The files and figures of a finished training.

    Attributes:
        generator: file of the generator.
        autoencoder: file of the autoencoder.
        generator_outcome: outcome of the generator's run.
        autoencoder_outcome: outcome of the autoencoder's run; None if the autoencoder was given.
    """

    generator: Path
    autoencoder: Path
    generator_outcome: GenerationOutcome
    autoencoder_outcome: GenerationOutcome | None


def train_on_clips(clips: Path, out: Path, options: TrainingOptions, reporter: ProgressReporter) -> TrainingResult:
    """Train on the training clips of a folder.

    Args:
        clips: the folder of clips.
        out: folder of the runs, ``autoencoder`` and ``generator``; another call with the same options continues.
        options: see `TrainingOptions`.
        reporter: receives the progress.

    Raises:
        DatasetError: clips are missing, broken, too short or not of one rig and size, no clip has the map that the
            network takes, the loss is not finite, or memory is exhausted.
        UsageError: `out` holds another run, the options do not fit, or a view has no caption.
        WeightsUnavailableError: the captions are missing, broken or of another size.
    """
    options = replace(options, device=resolve_device(options.device).name)
    torch.set_num_threads(options.threads)
    listed = read_list(clips).training
    if not listed:
        raise DatasetError("no training clips", file=clips, expected="at least one clip")
    network, references = options.settings.network, options.settings.references
    # Before a folder is made that could not be used, and before minutes are spent on an autoencoder.
    if options.autoencoder is not None:
        require_fit(read_autoencoder(options.autoencoder), network, OWN_STYLE, references, file=options.autoencoder)
    clips_hash = hash_clips(clips, listed)
    loaded = ClipFiles(clips, listed)
    require_clips(loaded.headers, network, references, clips)
    without_map = require_maps(loaded.headers, network, OWN_STYLE, clips)
    if without_map is not None:
        reporter.message(without_map)
    captions = read_clip_captions(options.captions, network, loaded.headers)
    first = loaded.headers[0]
    costs = count_costs(options.settings, first.size_px, len(first.views))
    speed = measure_speed(options.device, options.settings.precision)
    reporter.message(costs.describe(options.steps, options.device, speed))
    require_memory(options.device, costs.memory_bytes, TRAINING_REMEDY)
    outcome: GenerationOutcome | None = None
    autoencoder = options.autoencoder
    with (
        exhausted_memory_named(options.device, TRAINING_REMEDY),
        repeating_exactly(options.device),
        join_processes(options.device) as processes,
    ):
        options.settings.require_shares(processes.count)
        if autoencoder is None:
            with processes.leader_first():
                autoencoder, outcome = _train_autoencoder(loaded, clips_hash, out / "autoencoder", options, reporter)
        generator, done = _train_generator(
            loaded, clips_hash, autoencoder, captions, out / "generator", options, processes, reporter
        )
    return TrainingResult(generator, autoencoder, done, outcome)


def _train_autoencoder(
    clips: ClipFiles, clips_hash: str, path: Path, options: TrainingOptions, reporter: ProgressReporter
) -> tuple[Path, GenerationOutcome]:
    folder, settings = RunFolder(path, GenerationOutcome), options.autoencoder_settings
    run = GenerationRun(
        part="autoencoder", settings=settings.document, seed=options.seed, steps=options.autoencoder_steps,
        threads=options.threads, processes=1, clips_hash=clips_hash, autoencoder_hash=None,
        computed=describe_computation(CPU),
    )  # fmt: skip
    outcome = folder.begin(run)
    if outcome is None:
        with folder.claim(run):
            # The backgrounds too: a view without road users must come back as well.
            images = ClipImages(clips)
            trainer = AutoencoderTrainer(settings, images, options.autoencoder_steps, seed=options.seed)
            training = numbered_training(
                trainer, options.autoencoder_steps, lambda file: write_autoencoder(file, trainer.finish()),
                phase="autoencoder", loss="square", checkpoint_s=options.checkpoint_s,
                psnr_db=lambda: reconstruction_psnr_db(trainer.model, images[:: max(1, len(images) // 256)]),
            )  # fmt: skip
            outcome = train(training, folder, reporter)
    reporter.message(f"autoencoder: {outcome.psnr_db:.2f} dB on its training images")
    return folder.model, outcome


def _train_generator(
    clips: ClipFiles,
    clips_hash: str,
    autoencoder: Path,
    captions: CachedCaptions | None,
    path: Path,
    options: TrainingOptions,
    processes: Processes,
    reporter: ProgressReporter,
) -> tuple[Path, GenerationOutcome]:
    folder, settings = RunFolder(path, GenerationOutcome, processes), options.settings
    run = GenerationRun(
        part="generator", settings={**settings.document, **captions_document(options.captions)}, seed=options.seed,
        steps=options.steps, threads=options.threads, processes=processes.count, clips_hash=clips_hash,
        autoencoder_hash=file_sha256(autoencoder),
        computed=describe_computation(options.device, settings.precision),
    )  # fmt: skip
    outcome = folder.begin(run)
    if outcome is not None:
        return folder.model, outcome
    codec: LatentCodec = read_autoencoder(autoencoder)
    windows = ClipWindows(clips, codec, settings.network, OWN_STYLE, settings.references, captions)
    trainer = GeneratorTrainer(
        settings, windows, options.steps, seed=options.seed, device=processes.device, rank=processes.rank,
        processes=processes.count,
    )  # fmt: skip

    def sample(step: int) -> None:
        write_samples(
            path / "samples", f"{step:08d}", trainer.averaged_network, windows, codec, device=processes.device
        )

    training = numbered_training(
        trainer, options.steps,
        lambda file: write_generator(
            file, trainer.averaged_network(), settings.references, drop_layout=settings.drop_layout,
            rates_hz=rates_of(clips.headers),
            captions=captions is not None,
        ),
        phase="generator", loss=settings.weighting, checkpoint_s=options.checkpoint_s, sample=sample,
    )  # fmt: skip
    with folder.claim(run):
        return folder.model, train(training, folder, reporter)


def rates_of(clips: Sequence[ClipHeader]) -> tuple[float, float]:
    """Return the lowest and highest rate of clips, frames per second."""
    rates = [clip.rate_hz for clip in clips]
    return min(rates), max(rates)


def with_text_of(settings: GeneratorSettings, captions: Path) -> GeneratorSettings:
    """Return settings for a network that takes captions of the widths in a file of embeddings.

    Raises:
        WeightsUnavailableError: the file is missing or broken, or its embeddings differ in width.
    """
    text_channels, pooled_channels = embedding_widths(captions)
    network = replace(settings.network, text_channels=text_channels, pooled_channels=pooled_channels)
    return replace(settings, network=network)


def read_clip_captions(
    path: Path | None, config: TransformerConfig, clips: Sequence[ClipHeader]
) -> CachedCaptions | None:
    """Read the captions of clips; None if the training uses no text.

    Raises:
        UsageError: a view of a clip has none.
        WeightsUnavailableError: the file is missing or broken, or a caption has another size than the network takes.
    """
    if path is None:
        return None
    captions = CachedCaptions(path, config)
    for clip in clips:
        captions.require((clip.clip_id, clip.drive_id), clip.views)
    return captions


def captions_document(path: Path | None) -> dict[str, str]:
    """Describe the captions of a run's settings, for its document.

    It is empty without captions, so that such runs keep their documents.
    """
    return {} if path is None else {"captions": file_sha256(path)}


def hash_clips(folder: Path, clip_ids: tuple[str, ...]) -> str:
    """Return the SHA-256 over the ids and files of clips.

    Raises:
        DatasetError: a file is missing.
    """
    digest = hashlib.sha256()
    for clip_id in clip_ids:
        path = clip_path(folder, clip_id)
        if not path.is_file():
            raise DatasetError(
                "missing", file=path, expected="a clip that clips.json lists", remedy="make the clips again"
            )
        digest.update(f"{clip_id} {file_sha256(path)}\n".encode())
    return digest.hexdigest()


def without_background(settings: GeneratorSettings) -> GeneratorSettings:
    """Return settings for a network that does not receive the background."""
    return replace(settings, network=replace(settings.network, background=None))


def with_map(settings: GeneratorSettings) -> GeneratorSettings:
    """Return settings for a network that also takes the lines of a map.

    Raises:
        UsageError: the network takes no layout.
    """
    network = settings.network
    if network.layout is None:
        raise UsageError("a network without layout", place="--map", expected="one that takes layout images")
    channels = network.layout_frames * (OWN_STYLE.channels + MAP_CHANNELS)
    return replace(settings, network=replace(network, layout=replace(network.layout, channels=channels)))
