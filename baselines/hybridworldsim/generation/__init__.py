"""Dynamic scene generation: a video diffusion transformer that adds traffic to the images of a static street."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command(
    "reconstruction", "generate traffic over a street; train and distil generators", "hybridworldsim.generation.command"
)
