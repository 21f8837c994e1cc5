"""Methods that write a model in the format of 3D Gaussian Splatting, for viewers that do not know the method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.registry import installed_method
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class PlyExportOptions:
    """How to bake.

    Attributes:
        degree: of the spherical harmonics, 0 to 3.
        sky: what lies beyond the reach is pulled in to it, left out, or kept.
        reach_m: from the middle of the street.
    """

    degree: int = 3
    sky: Literal["pull", "clip", "keep"] = "pull"
    reach_m: float = 150.0


@dataclass(frozen=True)
class PlyExport:
    """What came of it.

    Attributes:
        gaussians: in the file.
        bytes: of the file.
        psnr_db: of its pictures against the model's, over all pixels of the views.
        origin_m: of the file's frame in the world of the scene.
    """

    gaussians: int
    bytes: int
    psnr_db: float
    origin_m: tuple[float, float, float]


@runtime_checkable
class PlyExporter(Protocol):
    """An installed method that can bake."""

    def export_ply(
        self,
        model: Path,
        views: Sequence[RenderView],
        out: Path,
        options: PlyExportOptions,
        appearance: AppearancePolicy = ...,
    ) -> PlyExport:
        """Write a model as a PLY.

        Args:
            model: its folder.
            views: of one camera on one drive: what is baked looks as they do.
            out: the file.
            options: how.
            appearance: how pictures look that were not trained on.
        """
        ...


def find_ply_exporter(name: str) -> PlyExporter:
    """An installed method that can bake.

    Raises:
        UsageError: there is none of that name, or it cannot.
    """
    method = installed_method(name)
    if not isinstance(method, PlyExporter):
        raise UsageError(f"{name} cannot bake", expected="a method with a function `export_ply`")
    return method
