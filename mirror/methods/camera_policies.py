"""Renderers whose cameras have appearance policies of their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.plugin import InstalledMethod
from mirror.protocols.views.view import RenderView


def parse_camera_policies(policies: str, cameras: Sequence[str]) -> dict[str, str]:
    """The policy of looks of each camera.

    Args:
        policies: one for all, or ``CAMERA=POLICY`` for some of them, separated by commas; the others keep their look.
        cameras: that there are.

    Raises:
        UsageError: a camera that there is not, or none is named.
    """
    if "=" not in policies:
        return dict.fromkeys(cameras, policies)
    named = [part.partition("=")[::2] for part in policies.split(",")]
    unknown = [camera for camera, policy in named if camera not in cameras or not policy]
    if unknown:
        raise UsageError(
            f"{policies!r}", place="--appearance", expected=f"CAMERA=LOOK,... of {', '.join(cameras)}"
        )  # fmt: skip
    return {**dict.fromkeys(cameras, AppearancePolicy().policy), **dict(named)}


def open_by_camera(
    method: InstalledMethod, model: Path, appearance: AppearancePolicy, policies: Mapping[str, str]
) -> Callable[[RenderView], UInt8]:
    """A renderer of views whose cameras have policies of their own."""
    renderers = {one: method.open(model, replace(appearance, policy=one)) for one in dict.fromkeys(policies.values())}
    return lambda view: renderers[policies[view.camera]](view)
