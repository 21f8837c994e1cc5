"""The MTGS-style method for its entry point."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hybridworldsim.methods.static import StaticMethod
from mirror_baselines.mtgs_style.settings import TUNED
from mirror_baselines.mtgs_style.trainer import make

METHOD: Final = StaticMethod("mtgs_style", make, lambda seed: replace(TUNED, seed=seed))
