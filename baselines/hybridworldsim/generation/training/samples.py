"""Samples during training: frames of some windows, beside their truth and their background."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch

from hybridworldsim.generation.autoencoder.codec import LatentCodec, to_bytes
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.sampler import draw_noise
from hybridworldsim.generation.training.windows import ClipWindows
from mirror.schema.files import write_bytes

_ENLARGED: Final = 2


def write_samples(
    folder: Path,
    name: str,
    network: Callable[[], Transformer],
    windows: ClipWindows,
    codec: LatentCodec,
    *,
    count: int = 6,
    device: str = "cpu",
    steps: int = 10,
) -> None:
    """Write an image with a row for each of some windows, evenly chosen.

    A row shows all views of the decoded truth, then those of the background, then those of the sample.

    Args:
        folder: folder of the samples.
        name: name of the file, so that names sort in time order.
        network: gives the network.
        windows: the windows.
        codec: the autoencoder.
        count: number of windows.
        device: where the network is.
        steps: steps of the sampler.
    """
    chosen = np.linspace(0, len(windows) - 1, count).round().astype(int).tolist()
    rows = []
    model = network()
    for number in chosen:
        batch = windows.batch([number])
        noise = draw_noise(batch.target.shape, (number,), device=device)
        with torch.no_grad():
            latents = sample_frame(
                model, batch.references.to(device), batch.conditions.to(device), noise, SamplerSettings(steps)
            )
            columns = [codec.decode(one[0, 0].cpu()) for one in (batch.target, latents)]
        background = batch.conditions.background
        if background is not None:
            columns.insert(1, background[0, -1])
        rows.append(np.concatenate([image for column in columns for image in to_bytes(column)], axis=1))
    sheet = cv2.resize(np.concatenate(rows), None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_NEAREST)
    _, data = cv2.imencode(".png", sheet[..., ::-1])
    write_bytes(folder / f"{name}.png", data.tobytes())
