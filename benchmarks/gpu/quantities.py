"""Quantities that are measured on a GPU, with their goals: the lines of the table of docs/performance.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from pydantic import Field

from mirror.schema.documents import Document

GAUSSIANS: Final = (300_000, 1_000_000, 3_000_000)
SIZES: Final = {300_000: "0.3 M", 1_000_000: "1 M", 3_000_000: "3 M"}
"""Numbers of Gaussians at full size, and their names."""

METHODS: Final = ("hybridworldsim", "hybridworldsim_structure", "mtgs_style", "vanilla_3dgs")
"""The methods of ``--full``."""
LEVELS_DB: Final = (25, 28, 30)
"""The qualities whose times ``--full`` reports."""


@dataclass(frozen=True)
class Quantity:
    """A figure that the benchmark measures, with its part and its unit.

    Attributes:
        part: the part that measures it.
        name: its name, unique within the part.
        unit: its unit.
        beside: what it is compared with, or its goal, in words.
    """

    part: str
    name: str
    unit: str
    beside: str = ""

    @property
    def key(self) -> str:
        """Return its key in documents."""
        return f"{self.part}: {self.name}"


class PartResult(Document):
    """The measurement of a part.

    Attributes:
        seconds: how long the part took.
        budget_s: how long it may take at full size.
        not_measured: why nothing or not all was measured; None: all was.
        values: by name of the quantity.
        curve: points ``(seconds, steps, psnr_db)`` of a training; empty for other parts.
        note: what was measured, in words.
    """

    seconds: float
    budget_s: float
    not_measured: str | None = None
    values: dict[str, float] = Field(default_factory=dict)
    curve: list[tuple[float, int, float]] = Field(default_factory=list)
    note: str = ""


class Measurement(Document):
    """The measurements of a device.

    Attributes:
        device: name of the processor or GPU.
        versions: versions of the libraries.
        scale: share of the full size.
        parts: results by name of the part.
    """

    device: str
    versions: dict[str, str]
    scale: float
    parts: dict[str, PartResult] = Field(default_factory=dict)


def list_quantities() -> Iterator[Quantity]:
    """Yield all quantities in the order of the table."""
    yield Quantity("checks", "colours, against the rasterizer of the CPU", "of 1", "at most 0.004")
    yield Quantity("checks", "gradients, against the rasterizer of the CPU", "share of the norm", "at most 0.001")
    yield Quantity("checks", "plain torch, against the compiled kernels", "share of the largest", "at most 0.0001")
    yield Quantity("checks", "200 steps here and on the CPU", "dB apart", "at most 0.15")
    yield Quantity("depth", "plane sweep of an image, 960x540, 160 planes, four sources", "ms")
    yield Quantity("depth", "fusion with eight depth maps", "ms")
    yield Quantity("depth", "mask of the sky", "ms")
    yield Quantity("depth", "pixels whose depth is not that of the kernels", "share", "at most 0.001, beyond 0.1 %")
    for name in SIZES.values():
        yield Quantity("rasterizer", f"{name} Gaussians, image", "ms")
        yield Quantity("rasterizer", f"{name} Gaussians, image, gsplat called directly", "ms", "its own figure")
        yield Quantity("rasterizer", f"{name} Gaussians, image and gradients", "ms")
        yield Quantity("rasterizer", f"{name} Gaussians, image and gradients, gsplat called directly", "ms")
    for count, name in SIZES.items():
        goal = "paper 21, goal 200" if count == 1_000_000 else "paper 21"
        yield Quantity("frames", f"{name} Gaussians, 960x540, decoded and rasterized", "frames a second", goal)
    yield Quantity("step", "a training step, 960x540", "ms")
    for name in ("decoding", "rasterizer, forward", "losses", "backward", "optimisers", "statistics of refinement"):
        yield Quantity("step", f"- {name}", "ms")
    yield Quantity("step", "rasterizer alone, forward and backward", "ms")
    yield Quantity("step", "overhead over the rasterizer alone", "%", "at most 100")
    yield Quantity("train", "7,000 steps of a block, 960 px", "s")
    yield Quantity("train", "PSNR of training images then", "dB")
    yield Quantity("train", "Gaussians then", "")
    yield Quantity("generation", "a frame of seven views, 448x256, four steps", "ms")
    yield Quantity("generation", "its operations", "TFLOP")
    yield Quantity("generation", "its time by operations at the speed of a large matrix product", "ms")
    yield Quantity("features", "Inception, 960x540", "images a second")
    yield Quantity("loop", "a closed-loop step, seven cameras 960x540", "ms", "six steps a second: 167")
    for method in METHODS:
        part = full_part(method)
        for level in LEVELS_DB:
            yield Quantity(part, f"time to {level} dB", "min")
        yield Quantity(part, "30,000 steps", "min", "at most 10" if method == METHODS[0] else "")
        yield Quantity(part, "PSNR of training images then", "dB")


def full_part(method: str) -> str:
    """Return the name of the part that trains a method at full length."""
    return f"full {method}"


BUDGETS_S: Final[Mapping[str, float]] = {
    "checks": 25.0,
    "depth": 10.0,
    "rasterizer": 15.0,
    "frames": 15.0,
    "step": 15.0,
    "train": 120.0,
    "generation": 10.0,
    "features": 10.0,
    "loop": 20.0,
}
"""Seconds of each part on a GPU, in its order: four minutes in all, without the street, which is made once."""
