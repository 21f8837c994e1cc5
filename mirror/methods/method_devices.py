"""The interface of a method that computes on the device that it is given."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from mirror.arrays import UInt8
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.views.view import RenderView


class DeviceMethod(Protocol):
    """A method that computes on any device of torch: the capability `takes_device`."""

    def open(
        self, model: Path, appearance: AppearancePolicy = ..., *, device: str = ...
    ) -> Callable[[RenderView], UInt8]:
        """Open a trained model as a renderer that computes on a device, such as ``cpu`` or ``cuda:0``."""
