"""Rasterization on CUDA, by gsplat."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.inputs import NonFinite, refuse_nonfinite
from hybridworldsim.rasterizer.presets import DEFAULT_PRESET, PRESETS, GsplatPreset
from hybridworldsim.rasterizer.rolling_shutter import to_shutter_type
from mirror.errors import UsageError
from mirror.installation import install_command

_DEFAULTS = {"camera_model": "pinhole", "segmented": False, "with_ut": False}


def rasterization(
    preset: GsplatPreset, nonfinite: NonFinite, **arguments: Any
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Call gsplat.

    Args:
        preset: the generation whose rules gsplat must follow.
        nonfinite: treatment of Gaussians that are not finite.
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
    if nonfinite == "cull":
        arguments |= _hide_nonfinite(arguments)
    if arguments["with_ut"] and arguments["packed"]:
        raise UsageError("gsplat's unscented transform is not packed", place="packed", remedy="packed=False")
    if arguments["colors"] is not None and nonfinite == "raise":
        refuse_nonfinite("colors", arguments["colors"].flatten(0, -2), "row")
    elif arguments["colors"] is None:
        # gsplat needs colours even if only depth is rendered
        arguments["colors"] = arguments["opacities"].detach()[..., None]
    if arguments["with_ut"] and arguments["rasterize_mode"] == "antialiased":
        raise UsageError(
            "gsplat's unscented transform does not antialias", place="rasterize_mode", expected="'classic'"
        )
    if arguments["viewmats_rs"] is not None:
        types = import_module("gsplat.cuda._wrapper").RollingShutterType
        arguments["rolling_shutter"] = types[to_shutter_type(arguments["rolling_shutter"]).name]
    else:
        arguments["rolling_shutter"] = None
    # releases before 1.5 lack some arguments, which are passed only if they differ from their defaults
    given = {name: value for name, value in arguments.items() if value is not None and value != _DEFAULTS.get(name)}
    return gsplat.rasterization(**given)


def preset_on(device: torch.device) -> str:
    """Return the preset that a model renders with on a device; on CUDA, the preset of the installed gsplat.

    Raises:
        UsageError: on CUDA, gsplat is not installed.
    """
    if device.type != "cuda":
        return DEFAULT_PRESET
    release = ".".join(_import_gsplat().__version__.split(".")[:2])
    return next((preset.name for preset in PRESETS.values() if release in preset.releases), DEFAULT_PRESET)


def _hide_nonfinite(arguments: Mapping[str, Any]) -> dict[str, Tensor]:
    """Make Gaussians that are not finite transparent, so that gsplat culls them; they get no gradients.

    Nothing is read back from the GPU. Colours for each camera, (..., C, N, D), are not looked at.
    """
    names = ["means", "quats", "scales", "opacities"]
    colours = arguments["colors"]
    if colours is not None and colours.shape[-2 if arguments["sh_degree"] is None else -3] == len(arguments["means"]):
        names.append("colors")
    tables = {name: arguments[name] for name in names}
    count = len(tables["means"])
    kept = torch.stack([table.detach().reshape(count, -1).isfinite().all(1) for table in tables.values()]).all(0)
    hidden = {}
    for name, table in tables.items():
        # A quaternion of zeros has no direction.
        instead = torch.ones_like(table) if name == "quats" else torch.zeros_like(table)
        hidden[name] = torch.where(kept.view(-1, *[1] * (table.ndim - 1)), table, instead)
    return hidden


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
