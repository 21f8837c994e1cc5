"""Renderers with a separate appearance policy for each camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from mirror.arrays import UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model import ModelFolder
from mirror.protocols.views.view import RenderView


def parse_camera_policies(policies: str, cameras: Sequence[str]) -> dict[str, str]:
    """Parse the appearance policy of each camera.

    Args:
        policies: one policy for all cameras, or ``CAMERA=POLICY`` for some of them, separated by commas; the other
            cameras get the default policy.
        cameras: names of all cameras.

    Raises:
        UsageError: a camera is unknown, or has no policy after the ``=``.
    """
    if "=" not in policies:
        return dict.fromkeys(cameras, policies)
    named = [part.partition("=")[::2] for part in policies.split(",")]
    unknown = [camera for camera, policy in named if camera not in cameras or not policy]
    if unknown:
        raise UsageError(
            f"{policies!r}", place="--appearance", expected=f"CAMERA=POLICY,... of {', '.join(cameras)}"
        )  # fmt: skip
    return {**dict.fromkeys(cameras, AppearancePolicy().policy), **dict(named)}


def open_by_camera(
    model: ModelFolder, appearance: AppearancePolicy, policies: Mapping[str, str], *, device: str = CPU
) -> Callable[[RenderView], UInt8]:
    """Open a renderer that uses, for each view, the policy of its camera.

    Args:
        model: trained model.
        appearance: settings that all cameras share.
        policies: policy by camera.
        device: where it computes, see `ModelFolder.choose_device`.
    """
    renderers = {
        policy: model.open(replace(appearance, policy=policy), device=device)
        for policy in dict.fromkeys(policies.values())
    }
    return lambda view: renderers[policies[view.camera]](view)
