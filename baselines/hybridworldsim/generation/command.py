"""The command line of ``mirror generate``."""

from __future__ import annotations

from collections.abc import Sequence

from hybridworldsim.generation.commands.clips import run_clips
from hybridworldsim.generation.commands.distil import run_distil
from hybridworldsim.generation.commands.scene import run_scene
from hybridworldsim.generation.commands.train import run_train
from mirror.command_line import Subcommand, run_subcommand


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "clips": Subcommand("make clips of a dataset's recordings over its static street", run_clips),
        "train": Subcommand("train a generator on a folder of clips", run_train),
        "distil": Subcommand("distil a trained generator to few steps", run_distil),
        "scene": Subcommand("generate the road users of a scene over its static street", run_scene),
    }
    return run_subcommand(argv, "mirror generate", subcommands)
