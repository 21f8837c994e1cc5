"""The files that a generator is read from: one that was trained here, or a released model; and its captions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hybridworldsim.generation.clips.captions import CachedCaptions
from hybridworldsim.generation.model_files import (
    captioned_config,
    read_autoencoder,
    read_generator,
    read_references,
    require_guidance,
    trained_rates,
)
from hybridworldsim.generation.scenes.released import ReleasedModel, autoencoder_hash, open_released
from hybridworldsim.generation.scenes.rollout import SceneGenerator, require_codec
from mirror.devices import resolve_device
from mirror.weights.resolve import file_sha256


@dataclass(frozen=True)
class GeneratorFiles:
    """The files that a generator is read from.

    Attributes:
        generator: ``model.safetensors`` of a generator, or the state dict of a released model.
        autoencoder: that of its autoencoder, or the folder ``vae`` of its pipeline.
        base: the released model; None: the generator was trained here.
        captions: file of embedded captions, see `CachedCaptions`; None: no text.
    """

    generator: Path
    autoencoder: Path
    base: ReleasedModel | None = None
    captions: Path | None = None

    def open(self, size_px: tuple[int, int], device: str = "cpu", guidance: float = 1.0) -> SceneGenerator:
        """Read the generator and its autoencoder, and move them to a device.

        Args:
            size_px: height and width of the images that are to be generated.
            device: where the generator runs.
            guidance: scale of guidance.

        Raises:
            UsageError: there is no such device, the generator cannot be guided, or it does not take the size.
            DatasetError: a file is missing, broken or of another kind, or they do not fit each other.
            WeightsUnavailableError: released weights are missing or broken, or those of another model.
        """
        if self.base is not None:
            return open_released(self.base, self.generator, self.autoencoder, size_px, device)
        opened = open_generator(self.generator, self.autoencoder, device, guidance)
        opened.require_size(size_px)
        return opened

    def read_captions(self) -> CachedCaptions | None:
        """Read the captions, or return None if there are none; the generator's parameters are not read.

        Raises:
            UsageError: the generator was trained without text.
            DatasetError: the file of the generator is missing, broken or of another kind.
            WeightsUnavailableError: the file is missing or broken, or a caption has another size than the network
                takes.
        """
        if self.captions is None:
            return None
        config = captioned_config(self.generator) if self.base is None else self.base.config
        return CachedCaptions(self.captions, config)

    @property
    def references(self) -> int:
        """T, the number of reference frames, without reading any parameters.

        Raises:
            DatasetError: the file is missing, broken, or no generator.
        """
        return read_references(self.generator) if self.base is None else self.base.references

    def trained_rates(self) -> tuple[float, float] | None:
        """Return the lowest and highest rate of the training, frames per second.

        None: the generator's file states none.

        Raises:
            DatasetError: the file is missing, broken, or no generator.
        """
        return trained_rates(self.generator) if self.base is None else (self.base.rate_hz, self.base.rate_hz)

    def hashes(self) -> dict[str, str]:
        """Return the hashes of all files by name; base and captions only if they are given."""
        hashes = {
            "generator": file_sha256(self.generator),
            "autoencoder": autoencoder_hash(self.autoencoder) if self.base else file_sha256(self.autoencoder),
        }
        if self.base is not None:
            hashes["base"] = self.base.name
        if self.captions is not None:
            hashes["captions"] = file_sha256(self.captions)
        return hashes


def open_generator(generator: Path, autoencoder: Path, device: str = "cpu", guidance: float = 1.0) -> SceneGenerator:
    """Read a generator trained by this package, and its autoencoder, and move them to a device.

    Raises:
        UsageError: there is no such device, or the generator cannot be guided.
        DatasetError: a file is missing, broken or of another kind, or they do not fit each other.
    """
    device = resolve_device(device).name
    require_guidance(generator, guidance)
    network, references = read_generator(generator)
    codec = read_autoencoder(autoencoder)
    require_codec(
        network.config, codec, autoencoder, "--autoencoder", "the autoencoder that the generator was trained with",
        "name it with --autoencoder",
    )  # fmt: skip
    return SceneGenerator(network.to(device), codec.to(device), references)
