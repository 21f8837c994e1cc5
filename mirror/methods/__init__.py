"""Methods as plug-ins: their interface, the registry of installed methods, training images and model documents."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.methods.appearance import AppearancePolicy as AppearancePolicy
    from mirror.methods.capabilities import Capabilities as Capabilities
    from mirror.methods.model import open_model as open_model
    from mirror.methods.plugin import InstalledMethod as InstalledMethod
    from mirror.methods.plugin import Method as Method
    from mirror.methods.plugin import ReconstructionResult as ReconstructionResult
    from mirror.methods.plugin import ReconstructionTask as ReconstructionTask
    from mirror.protocols.views.view import RenderView as RenderView

__all__ = [
    "AppearancePolicy",
    "Capabilities",
    "InstalledMethod",
    "Method",
    "ReconstructionResult",
    "ReconstructionTask",
    "RenderView",
    "open_model",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "AppearancePolicy": "mirror.methods.appearance",
        "Capabilities": "mirror.methods.capabilities",
        "InstalledMethod": "mirror.methods.plugin",
        "Method": "mirror.methods.plugin",
        "ReconstructionResult": "mirror.methods.plugin",
        "ReconstructionTask": "mirror.methods.plugin",
        "RenderView": "mirror.protocols.views.view",
        "open_model": "mirror.methods.model",
    },
)
