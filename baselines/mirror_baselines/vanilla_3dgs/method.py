"""3D Gaussian splatting as published, for its entry point."""

from __future__ import annotations

from functools import partial
from typing import Final

from hybridworldsim.methods.static import StaticMethod
from mirror_baselines.splatting.renderer import SplattingRenderer
from mirror_baselines.splatting.scaling import scale_counts, with_seed
from mirror_baselines.splatting.settings import table_sizes
from mirror_baselines.vanilla_3dgs.settings import TUNED
from mirror_baselines.vanilla_3dgs.trainer import make, make_empty

METHOD: Final = StaticMethod(
    "vanilla_3dgs",
    make,
    partial(with_seed, TUNED),
    make_empty=make_empty,
    capabilities=SplattingRenderer.CAPABILITIES,
    sizes=table_sizes,
    scale=scale_counts,
)
