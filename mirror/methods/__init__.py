"""Methods as plug-ins: their interface, the registry of installed methods, training images and model documents."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.methods.appearance import AppearancePolicy as AppearancePolicy
    from mirror.methods.plugin import InstalledMethod as InstalledMethod
    from mirror.methods.plugin import ReconstructionResult as ReconstructionResult
    from mirror.methods.plugin import ReconstructionTask as ReconstructionTask
    from mirror.protocols.views.view import RenderView as RenderView

__all__ = [
    "AppearancePolicy",
    "InstalledMethod",
    "ReconstructionResult",
    "ReconstructionTask",
    "RenderView",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "AppearancePolicy": "mirror.methods.appearance",
        "InstalledMethod": "mirror.methods.plugin",
        "ReconstructionResult": "mirror.methods.plugin",
        "ReconstructionTask": "mirror.methods.plugin",
        "RenderView": "mirror.protocols.views.view",
    },
)
