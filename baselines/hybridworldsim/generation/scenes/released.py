"""Released models of OpenDWM as generators of scenes: weights, autoencoder, and the conventions of their training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import torch

from hybridworldsim.generation.autoencoder.of_diffusers import CONFIG, WEIGHTS, load_autoencoder
from hybridworldsim.generation.layout.boxes import OPENDWM_STYLE, BoxStyle
from hybridworldsim.generation.network.checkpoints import load_transformer
from hybridworldsim.generation.network.configuration import BASES, TransformerConfig
from hybridworldsim.generation.scenes.rollout import SceneGenerator, require_codec, require_size
from mirror.devices import resolve_device
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import file_sha256

NO_BACKGROUND: Final = (
    "the released weights have no background adapter: pixels that they generate do not follow the background"
)


@dataclass(frozen=True)
class ReleasedModel:
    """The settings of a released model, with the values of its released configuration.

    Attributes:
        name: its name.
        config: configuration of its network. References are frames of the sequence, and frames attend to each other in
            both directions.
        steps: steps of the sampler.
        guidance: scale of guidance. OpenDWM guides by layout and text; here it is by layout.
        trained_on: data of its training.
        style: how layouts are drawn.
        references: T, number of reference frames.
        shift: shift of the noise levels, that of Stable Diffusion 3.
        rate_hz: frames per second of its training.
        size_px: height and width of its training's images.
    """

    name: str
    config: TransformerConfig
    steps: int
    guidance: float
    trained_on: str
    style: BoxStyle = OPENDWM_STYLE
    references: int = 3
    shift: float = 3.0
    rate_hz: float = 10.0
    size_px: tuple[int, int] = (256, 448)


RELEASED: Final = {
    "ctsd-35": ReleasedModel(
        "ctsd-35", BASES["ctsd-35"], steps=40, guidance=4.0, trained_on="nuScenes, Waymo, Argoverse 2, OpenDV"
    ),
    "unimlvg": ReleasedModel(
        "unimlvg", BASES["unimlvg"], steps=50, guidance=3.0, trained_on="nuScenes, Waymo, Argoverse 2, OpenDV",
        style=replace(OPENDWM_STYLE, dropped=0.0),
    ),
}  # fmt: skip
"""Released models, by the names of `BASES`."""


def released_model(name: str) -> ReleasedModel:
    """Return a released model by name.

    Raises:
        UsageError: there is none of this name.
    """
    if name not in RELEASED:
        raise UsageError(f"no base {name!r}", place="--base", expected=f"one of {', '.join(RELEASED)}")
    return RELEASED[name]


def open_released(
    model: ReleasedModel, checkpoint: Path, vae: Path, size_px: tuple[int, int], device: str = "cpu"
) -> SceneGenerator:
    """Load a released model; unsuitable settings are refused before the network's weights are read.

    Args:
        model: which one.
        checkpoint: its state dict.
        vae: the folder ``vae`` of the pipeline of Stable Diffusion 3 that it was trained on.
        size_px: height and width of the images that are to be generated.
        device: where the generator runs.

    Raises:
        UsageError: there is no such device, diffusers is not installed, or the network does not take the size.
        DatasetError: the autoencoder is not that of the model.
        WeightsUnavailableError: a file is missing or broken, or belongs to another model.
    """
    device = resolve_device(device).name
    require_size(model.config, size_px, f"choose such a --size: training had {model.size_px[1]}x{model.size_px[0]}")
    if not checkpoint.is_file():
        raise WeightsUnavailableError("no such file", file=checkpoint, expected=f"the state dict of {model.name}")
    codec = load_autoencoder(vae)
    require_codec(
        model.config, codec, vae, "--vae", "the autoencoder of the Stable Diffusion that the model was trained on",
        "name the folder `vae` of that pipeline",
    )  # fmt: skip
    network = load_transformer(checkpoint, model.config, dtype=torch.float32).eval().requires_grad_(False)
    return SceneGenerator(network.to(device), codec.to(device), model.references, model.style, ring=True)


def autoencoder_hash(vae: Path) -> str:
    """Return the hashes of the files of an autoencoder's folder."""
    return " ".join(file_sha256(vae / name) for name in (CONFIG, WEIGHTS))
