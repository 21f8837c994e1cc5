"""The machine that is measured: its device, its size of inputs, and times that wait for the device."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import torch

from mirror.devices import CPU, hardware_name, library_versions

WIDTH_PX, HEIGHT_PX = 960, 540
_LEAST_PX: Final = 32


@dataclass(frozen=True)
class Machine:
    """A device, and the share of the full size that is measured on it.

    Attributes:
        device: as torch names it.
        scale: share of Gaussians, pixels and steps; 1 is the full size.
    """

    device: str
    scale: float = 1.0

    @property
    def is_gpu(self) -> bool:
        """Return whether the device is a GPU."""
        return self.device != CPU

    @property
    def name(self) -> str:
        """Return the name of the processor or GPU."""
        return hardware_name(self.device)

    @property
    def slug(self) -> str:
        """Return the name in the form of a file's name."""
        return re.sub(r"[^a-z0-9]+", "-", self.name.lower()).strip("-")

    def versions(self) -> Mapping[str, str]:
        """Return the versions of the libraries."""
        return library_versions(self.device, splats=True)

    def count(self, full: int, least: int = 1) -> int:
        """Return a number of Gaussians or steps at this scale."""
        return max(least, round(full * self.scale))

    def size_px(self, width: int = WIDTH_PX, height: int = HEIGHT_PX, multiple: int = 1) -> tuple[int, int]:
        """Return the width and height of an image with the scaled number of pixels.

        Args:
            width: width at full size.
            height: height at full size.
            multiple: both are multiples of it.
        """
        side = self.scale**0.5
        wide, high = (max(_LEAST_PX // 2, multiple, round(side * one / multiple) * multiple) for one in (width, height))
        return wide, high

    def wait(self) -> None:
        """Wait until the device has computed all that was asked of it."""
        if self.is_gpu:
            torch.cuda.synchronize(self.device)

    def median_ms(self, call: Callable[[], object], budget_s: float, most: int = 50) -> float:
        """Return the median time of calls, after one that does not count; at least three, within a budget of time."""
        call()
        self.wait()
        times: list[float] = []
        begin = time.monotonic()
        while len(times) < 3 or (len(times) < most and time.monotonic() - begin < budget_s):
            start = time.perf_counter()
            call()
            self.wait()
            times.append((time.perf_counter() - start) * 1e3)
        return float(np.median(times))


@dataclass
class Stopwatch:
    """A measurement of the time of functions, by name, for which the device is waited.

    Attributes:
        machine: the machine.
        total_ms: sum of the times of each function.
    """

    machine: Machine
    total_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def watching(self, functions: Mapping[str, tuple[Any, str]]) -> Iterator[None]:
        """Measure functions while the context is open.

        Args:
            functions: the owner (module or class) and the attribute of each function, by name of the part.
        """
        before = {name: getattr(owner, attribute) for name, (owner, attribute) in functions.items()}
        for name, (owner, attribute) in functions.items():
            setattr(owner, attribute, self._timed(name, before[name]))
        try:
            yield
        finally:
            for name, (owner, attribute) in functions.items():
                setattr(owner, attribute, before[name])

    def _timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **options: Any) -> Any:
            self.machine.wait()
            start = time.perf_counter()
            try:
                return function(*args, **options)
            finally:
                self.machine.wait()
                self.total_ms[name] = self.total_ms.get(name, 0.0) + (time.perf_counter() - start) * 1e3

        return timed
