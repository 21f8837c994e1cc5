"""The metrics that a protocol can name, each with its options; `mirror.metrics` and the scorers compute them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import Field

from mirror.metrics.catalogue import plain_names
from mirror.schema.documents import Document

if TYPE_CHECKING:
    _OfImages: TypeAlias = str
    _OfMethods: TypeAlias = str
    _OfRollouts: TypeAlias = str
else:
    _OfImages, _OfMethods, _OfRollouts = (Literal[plain_names(kind)] for kind in ("image", "method", "rollout"))


class ImageMetric(Document):
    """A metric of single images without options, which the catalogue describes (mirror/metrics/catalogue.py)."""

    metric: _OfImages


class PsnrCcMetric(Document):
    """PSNR after the quadratic colour warp of MTGS (PSNR* in the paper); ``iterations`` fits on unclipped pixels."""

    metric: Literal["psnr_cc"]
    iterations: int = Field(default=5, ge=1)


class SsimMetric(Document):
    """Structural similarity; ``preset`` sets window and border, ``mask`` sets how masked pixels are treated."""

    metric: Literal["ssim"]
    preset: Literal["gaussian11", "uniform7", "torchmetrics", "3dgs"]
    mask: Literal["map", "erode", "normalised"]


class LpipsMetric(Document):
    """Learned perceptual similarity. Unscored pixels are black in both images, or left out of the mean of the map."""

    metric: Literal["lpips"]
    net: Literal["alex", "vgg", "squeeze"]
    mask: Literal["zero-fill", "map"]


class FidMetric(Document):
    """Frechet distance of Inception features; ``mode`` of resizing; warns if there are < ``warn_below`` images."""

    metric: Literal["fid"]
    mode: Literal["clean", "tf1"]
    warn_below: int = Field(default=2048, ge=2)


class KidMetric(Document):
    """Kernel distance of Inception features (unbiased estimator)."""

    metric: Literal["kid"]
    mode: Literal["clean", "tf1"]


class FvdMetric(Document):
    """Frechet distance of I3D features of clips of ``frames`` images, each resized or cropped to 224 x 224."""

    metric: Literal["fvd"]
    frames: int = Field(ge=9)
    crop: Literal["squeeze", "centre"]
    ddof: Literal[0, 1]


class EditIou(Document):
    """Intersection over union of an edited region and its target box.

    ``hull``: the region and the convex hull of the projected box. ``box``: the tight upright rectangles of both.
    ``ceiling``: the region and the hull's rectangle, divided by the IoU of the hull and that rectangle, because no
    vehicle fills its rectangle.
    """

    metric: Literal["edit_iou"]
    variant: Literal["hull", "box", "ceiling"]


Part = Literal["old", "new", "outside", "least"]


class EditFidelity(Document):
    """A full-reference figure of a part of an image that edits vehicles, against the exact truth of the edit.

    ``old`` and ``new``: the hulls of the vehicles' recorded and target boxes, grown by 20 %. ``outside``: the rest.
    ``least``: the least of the three. Groups whose vehicles stay have no value, nor have images without a target.

    Attributes:
        metric: always ``edit_fidelity``.
        part: part of the image.
        figure: the figure.
    """

    metric: Literal["edit_fidelity"]
    part: Part
    figure: Annotated[ImageMetric | SsimMetric, Field(discriminator="metric")]


class Detection(Document):
    """nuScenes detection metrics: AP over centre distances, true-positive errors, NDS.

    Attributes:
        metric: always ``nuscenes_detection``.
        absent: treatment of classes without a true box: ``present`` leaves them out, ``devkit`` counts them as 0.
        class_range_m: classes, each with the largest distance from the ego at which its boxes are scored.
        max_boxes_per_frame: submissions with more boxes in a frame are refused.
    """

    metric: Literal["nuscenes_detection"]
    absent: Literal["present", "devkit"]
    class_range_m: dict[str, float]
    max_boxes_per_frame: int = Field(default=500, ge=1, le=10_000)


class ReportedFigure(Document):
    """A figure that the submission's manifest states. It is measured again if the method is installed."""

    metric: _OfMethods


class SafetyMetric(Document):
    """A figure of a rollout's safety (docs/safety.md)."""

    metric: _OfRollouts


class LeastTtc(Document):
    """Least time to collision of a rollout, at most ``horizon_s``."""

    metric: Literal["least_ttc"]
    horizon_s: float = Field(gt=0, le=60)


class DrivableArea(Document):
    """Share of rollouts in which no corner of the ego is farther than ``tolerance_m`` outside the drivable area."""

    metric: Literal["drivable_area"]
    tolerance_m: float = Field(ge=0, le=10)


Metric = Annotated[
    ImageMetric
    | PsnrCcMetric
    | SsimMetric
    | LpipsMetric
    | FidMetric
    | KidMetric
    | FvdMetric
    | EditIou
    | EditFidelity
    | Detection
    | ReportedFigure
    | SafetyMetric
    | LeastTtc
    | DrivableArea,
    Field(discriminator="metric"),
]


def metric_name(metric: Metric) -> str:
    """Return the name of a metric's figure: the metric, with its variant or network if it has several."""
    if isinstance(metric, EditIou):
        return f"edit_iou_{metric.variant}"
    if isinstance(metric, EditFidelity):
        return f"{metric.figure.metric}_{metric.part}"
    if isinstance(metric, LpipsMetric):
        return f"lpips_{metric.net}"
    return metric.metric


def figure_names(metric: Metric) -> tuple[str, ...]:
    """Return the names of a metric's figures that can rank; most metrics have one."""
    return ("mean_ap", "nds_no_attr") if isinstance(metric, Detection) else (metric_name(metric),)
