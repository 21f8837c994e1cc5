"""The interface of methods that export a model as the PLY of 3D Gaussian Splatting, which common viewers can open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class PlyExportOptions:
    """Settings of an export as PLY.

    Attributes:
        degree: degree of the spherical harmonics, 0 to 3.
        sky: treatment of Gaussians farther than `reach_m`: pulled in to that distance, left out, or kept.
        reach_m: distance from the middle of the street.
    """

    degree: int = 3
    sky: Literal["pull", "clip", "keep"] = "pull"
    reach_m: float = 150.0


@dataclass(frozen=True)
class PlyExport:
    """Figures of an exported file.

    Attributes:
        gaussians: number of Gaussians in the file.
        bytes: size of the file.
        psnr_db: PSNR of the file's renders against the model's renders, over all pixels of the views.
        origin_m: origin of the file's frame in the world frame of the scene.
    """

    gaussians: int
    bytes: int
    psnr_db: float
    origin_m: tuple[float, float, float]


class PlyExporter(Protocol):
    """A method that can export a PLY: the capability `exports_ply`."""

    def export_ply(
        self,
        model: Path,
        views: Sequence[RenderView],
        out: Path,
        options: PlyExportOptions,
        appearance: AppearancePolicy = ...,
    ) -> PlyExport:
        """Write a model as a PLY file.

        Args:
            model: folder of the model.
            views: views of one camera on one drive; the file has the appearance of these views.
            out: PLY file to write.
            options: settings of the export.
            appearance: appearance policy for views that were not trained on.
        """
        ...
