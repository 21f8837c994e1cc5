"""Multi-view stereo: depth maps and points from posed images, the initialisation of a reconstruction."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command("reconstruction", "estimate layers of depth, points and sky masks", "hybridworldsim.mvs.command")
