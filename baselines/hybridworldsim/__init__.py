"""HybridWorldSim, the model of the paper: static reconstruction, dynamic generation, closed-loop simulation.

``import hybridworldsim`` loads nothing heavy. The names below are imported on first use.
"""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from hybridworldsim.methods.street import METHOD as METHOD
    from hybridworldsim.methods.street import open_model as open_model
    from hybridworldsim.model.settings import Settings as Settings
    from hybridworldsim.rasterizer import rasterization as rasterization

__all__ = ["METHOD", "Settings", "open_model", "rasterization"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "METHOD": "hybridworldsim.methods.street",
        "Settings": "hybridworldsim.model.settings",
        "open_model": "hybridworldsim.methods.street",
        "rasterization": "hybridworldsim.rasterizer",
    },
)
