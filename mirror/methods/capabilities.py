"""The capabilities of methods: what a method can do besides reconstructing and rendering, stated as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from mirror.methods.depth_renderers import CoverRenderer, DepthRenderer, ExposingRenderer
from mirror.methods.interactive import InteractiveMethod
from mirror.methods.method_devices import DeviceMethod
from mirror.methods.ply_export import PlyExporter
from mirror.plugins import PluginKind, list_parts


@dataclass(frozen=True)
class Capabilities:
    """The capabilities of a method beyond `reconstruct` and `open`, each of which needs a function.

    Attributes:
        renders_depth: its renderers have `render` (`mirror.methods.depth_renderers.DepthRenderer`), which simulators
            need.
        renders_covers: its renderers have `render_covers` (`mirror.methods.depth_renderers.CoverRenderer`).
        separates_exposure: its renderers have `render_unexposed` and `expose`
            (`mirror.methods.depth_renderers.ExposingRenderer`): simulators draw road users before the exposure.
        has_headlights: it knows the vehicle's own light, which `AppearancePolicy.headlights` turns off.
        opens_interactively: it has `open_interactive` (`mirror.methods.interactive.InteractiveMethod`): a renderer that
            mixes appearances and reuses work while the camera moves.
        exports_ply: it has `export_ply` (`mirror.methods.ply_export.PlyExporter`).
        takes_device: it computes on any device of torch: `reconstruct` reads `ReconstructionTask.device`, and `open`
            and `open_interactive` take the argument `device` (`mirror.methods.method_devices.DeviceMethod`). Other
            methods compute where they choose, and `--device` refuses a GPU for them.
        rasterizes: on a GPU it needs gsplat.
        distributes_blocks: `reconstruct` reads `ReconstructionTask.executor`. Others refuse `--executor`.
    """

    renders_depth: bool = False
    renders_covers: bool = False
    separates_exposure: bool = False
    has_headlights: bool = False
    opens_interactively: bool = False
    exports_ply: bool = False
    takes_device: bool = False
    rasterizes: bool = False
    distributes_blocks: bool = False

    @property
    def names(self) -> frozenset[str]:
        """Return the names of the stated capabilities."""
        return frozenset(name for name, stated in vars(self).items() if stated)


NEEDED_OF_METHOD: Final[Mapping[str, type]] = {
    "opens_interactively": InteractiveMethod,
    "exports_ply": PlyExporter,
}
"""What a method needs for a capability, by the capability's name."""

NEEDED_IF_STATED: Final[Mapping[str, type]] = {"takes_device": DeviceMethod}
"""The same for capabilities that functions do not show: every method has a function `open`."""

NEEDED_OF_RENDERER: Final[Mapping[str, type]] = {
    "renders_depth": DepthRenderer,
    "renders_covers": CoverRenderer,
    "separates_exposure": ExposingRenderer,
}
"""What the renderers of a method need for a capability, by the capability's name."""


def find_capabilities(method: object, renderer: object | None = None) -> Capabilities:
    """Find the capabilities of a method: the stated ones, or the ones that its functions and renderer show.

    Args:
        method: the method. Its attribute `capabilities` may be None, or absent as in methods written for 0.1.
        renderer: what its `open` returned; None: not opened. Only a statement tells then whether it renders depth.
    """
    stated: Capabilities | None = getattr(method, "capabilities", None)
    if stated is not None:
        return stated
    needed = [(method, NEEDED_OF_METHOD), (renderer, NEEDED_OF_RENDERER)]
    return Capabilities(
        **{name: not _absent_parts(owner, part) for owner, parts in needed for name, part in parts.items()}
    )


def require_capabilities(kind: PluginKind, method: object, name: str) -> None:
    """Require that a method has the functions of the capabilities that it states.

    Args:
        kind: the kind of plug-in that a method is.
        method: the method.
        name: its name, for messages.

    Raises:
        MirrorError: a function is absent or does not take its host's arguments, or the statement is no `Capabilities`.
    """
    stated = getattr(method, "capabilities", None)
    if not isinstance(stated, Capabilities | None):
        raise kind.error(
            f"its capabilities are {type(stated).__name__}", file=name, place=kind.option,
            expected="a mirror.methods.Capabilities, or None", remedy=f"mend the method {name}",
        )  # fmt: skip
    if stated is not None:
        _require_functions(kind, method, name, stated, {**NEEDED_OF_METHOD, **NEEDED_IF_STATED})


def require_renderer_capabilities(kind: PluginKind, method: object, renderer: object, name: str) -> None:
    """Require that a renderer has the functions of the capabilities that its method states.

    Args:
        kind: the kind of plug-in that a method is.
        method: the method.
        renderer: what its `open` returned.
        name: name of the method, for messages.

    Raises:
        MirrorError: a function is absent or does not take its host's arguments.
    """
    stated: Capabilities | None = getattr(method, "capabilities", None)
    if stated is not None:
        _require_functions(kind, renderer, name, stated, NEEDED_OF_RENDERER)


def _require_functions(
    kind: PluginKind, owner: object, name: str, stated: Capabilities, needed: Mapping[str, type]
) -> None:
    for capability, interface in needed.items():
        if capability not in stated.names:
            continue
        if absent := _absent_parts(owner, interface):
            has_it = "its renderer" if needed is NEEDED_OF_RENDERER else "it"
            raise kind.error(
                f"it states the capability {capability}, but {has_it} has no function {', '.join(absent)}",
                file=name, place=kind.option, remedy=f"mend the method {name}",
                expected=f"a function as {interface.__module__}.{interface.__qualname__} describes it",
            )  # fmt: skip
        kind.require_parts(owner, name, interface)


def _absent_parts(owner: object, interface: type) -> list[str]:
    return [part for part in sorted(list_parts(interface)) if getattr(owner, part, None) is None]
