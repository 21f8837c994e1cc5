"""Self-rollout: the references of a training window are the network's own output instead of recorded frames.

In a rollout a network sees its own errors; a network that has been trained on recorded references only does not know
them, and they add up (X. Huang et al., "Self Forcing", 2025). No gradient passes through the rollout.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.windows import ClipWindow

# Tells these random numbers from the others of a step, which are drawn from up to three numbers.
_STREAM: Final = 1


def draw_self_rollout(seed: int, step: int, place: int, probability: float) -> int | None:
    """Decide whether the references of a window are the network's own output.

    Args:
        seed: seed of the training.
        step: number of the step.
        place: place of the window in the batch of all processes.
        probability: share of the windows for which they are.

    Returns:
        The seed of the rollout's noise, or None if the references are the recorded frames.
    """
    rng = np.random.default_rng([seed, step, place, _STREAM])
    return int(rng.integers(1 << 62)) if rng.random() < probability else None


@torch.no_grad()
def roll_out_references(
    network: Transformer, history: ClipWindow, references: int, settings: SamplerSettings, seed: int
) -> Tensor:
    """Generate the last frames before a target from the frames before them.

    The first T frames are recorded ones and seed the rollout. Views that do not exist keep their latents.

    Args:
        network: the network, on the device of the latents.
        history: the T to 2 T frames before the target.
        references: T, number of reference frames.
        settings: how a frame is sampled.
        seed: of the noise.

    Returns:
        (1, T, V, C, H, W) latents of the T frames before the target.
    """
    latents, conditions = history.latents, history.conditions
    rollout = SequenceRollout(
        network, latents[:, :references], conditions[:references], settings, seed=seed, first=references
    )
    frames = [latents[:, :references]]
    for frame in range(references, latents.shape[1]):
        present = history.present[frame].nonzero().flatten().tolist()
        frames.append(rollout.step(conditions[frame], active=present, kept=latents[:, frame : frame + 1]))
    return torch.cat(frames, dim=1)[:, -references:]
