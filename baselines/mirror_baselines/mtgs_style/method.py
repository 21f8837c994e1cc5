"""The MTGS-style method for its entry point."""

from __future__ import annotations

from functools import partial
from typing import Final

from hybridworldsim.methods.static import StaticMethod
from mirror_baselines.mtgs_style.settings import TUNED
from mirror_baselines.mtgs_style.trainer import make, make_empty
from mirror_baselines.splatting.renderer import SplattingRenderer
from mirror_baselines.splatting.scaling import scale_counts, with_seed
from mirror_baselines.splatting.settings import table_sizes

METHOD: Final = StaticMethod(
    "mtgs_style",
    make,
    partial(with_seed, TUNED),
    make_empty=make_empty,
    capabilities=SplattingRenderer.CAPABILITIES,
    sizes=table_sizes,
    scale=scale_counts,
)
