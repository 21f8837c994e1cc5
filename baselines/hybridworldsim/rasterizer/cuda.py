"""Rasterization on CUDA, by gsplat."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from torch import Tensor

from hybridworldsim.rasterizer.inputs import NonFinite, refuse_nonfinite
from hybridworldsim.rasterizer.presets import PRESETS, GsplatPreset
from mirror.errors import UsageError
from mirror.installation import install_command

_DEFAULTS = {"camera_model": "pinhole", "segmented": False, "with_ut": False}


def rasterization(
    preset: GsplatPreset, nonfinite: NonFinite, **arguments: Any
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Call gsplat.

    Args:
        preset: the generation whose rules gsplat must follow.
        nonfinite: treatment of Gaussians that are not finite: only "raise".
        arguments: arguments of `gsplat.rasterization`, by name.

    Returns:
        The result of `gsplat.rasterization`.

    Raises:
        UsageError: gsplat is not installed, follows another preset, or does not support an argument.
    """
    gsplat = _import_gsplat()
    release = ".".join(gsplat.__version__.split(".")[:2])
    if release not in preset.releases:
        same = next((other.name for other in PRESETS.values() if release in other.releases), None)
        raise UsageError(
            f"gsplat {gsplat.__version__} is installed, which does not render as {preset.name}",
            place="preset",
            expected="gsplat " + " or ".join(preset.releases),
            remedy=f'preset="{same}"' if same else "install a release that a preset follows",
        )
    if nonfinite != "raise":
        raise UsageError("gsplat's CUDA kernels cull nothing that is not finite", place="nonfinite", expected="'raise'")
    if arguments["with_ut"] and arguments["packed"]:
        raise UsageError("gsplat's unscented transform is not packed", place="packed", remedy="packed=False")
    if arguments["colors"] is not None:
        refuse_nonfinite("colors", arguments["colors"].flatten(0, -2), "row")
    else:
        # gsplat needs colours even if only depth is rendered
        arguments["colors"] = arguments["opacities"].detach()[..., None]
    # releases before 1.5 lack some arguments, which are passed only if they differ from their defaults
    given = {name: value for name, value in arguments.items() if value is not None and value != _DEFAULTS.get(name)}
    return gsplat.rasterization(**given)


def _import_gsplat() -> ModuleType:
    """Import gsplat, or raise `UsageError`."""
    try:
        import gsplat
    except ImportError as error:
        raise UsageError(
            f"gsplat cannot be imported: {error}",
            place='backend="cuda"',
            remedy=f"{install_command('gpu')}, or move the tensors to the CPU",
        ) from error
    return gsplat
