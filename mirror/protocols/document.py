"""Protocols: what a submission is asked for and how it is scored, as data (TOML) with a hash of what it says."""

from __future__ import annotations

import hashlib
import json
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import SchemaError, UsageError
from mirror.geometry.cameras import WIDEST_DEG
from mirror.schema.documents import Document, Identifier, Role

RESERVED: Final = {"safety": "it follows with the closed-loop simulator"}
"""Names that a protocol will have, and why there is none yet."""

ScoringTask = Literal[
    "reconstruction",
    "lane-shift",
    "vehicle-translation",
    "generation",
    "editing-accuracy",
    "annotation",
    "runtime",
]
Slug = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.\-]{0,39}$")]


class Group(Document):
    """Renders that are scored together: a column of a table.

    Attributes:
        name: first folder of their paths.
        roles: of the traversals, in the split.
        ego_shift_m: how far the cameras are moved along the ego's y, that is to its left.
        vehicle_shift_m: how far the chosen vehicles are moved along their own y, to their left; None: nothing is
            edited.
        without_vehicles: the chosen vehicles are taken out: what stands behind them.
    """

    name: Slug
    roles: tuple[Role, ...] = Field(min_length=1)
    ego_shift_m: float = 0.0
    vehicle_shift_m: float | None = None
    without_vehicles: bool = False

    @model_validator(mode="after")
    def _one_edit(self) -> Group:
        if self.without_vehicles and self.vehicle_shift_m is not None:
            raise ValueError("a group moves vehicles or takes them out, not both")
        return self


class Frames(Document):
    """Which frames of a traversal are rendered.

    Attributes:
        every: each so many-th, from the first (MTGS: 5, 10 Hz to 2 Hz; OmniRe for novel views: 10).
        first: position of the first one. No part of the hash where it is 0.
        last: the last one too, as MTGS has it.
        cameras: of the rig; None: all.
    """

    every: int = Field(ge=1)
    first: int = Field(default=0, ge=0, exclude_if=lambda first: first == 0)
    last: bool
    cameras: tuple[str, ...] | None = None


class Pixels(Document):
    """The raster in which renders are compared.

    Attributes:
        space: ``raw``: through the camera's own lens. ``undistorted``: as a pinhole at the same place with a raster of
            the same size that holds all that the lens sees (OpenCV's alpha = 1, as MTGS has it).
        widest_deg: ``undistorted``: what is farther than this from the axis is left out, or a fisheye would shrink
            its middle to nothing.
        max_width_px: a wider raster is scaled down to this width, its height in proportion; none is enlarged.
        picture_resize: ``area``: each pixel is the mean of what it covers.
        mask_resize: ``all``: a pixel is scored if all that it covers is. ``nearest``: if its centre is, as MTGS has it.
    """

    space: Literal["raw", "undistorted"]
    widest_deg: float = Field(default=WIDEST_DEG, gt=0, lt=89)
    max_width_px: int = Field(ge=16, le=8192)
    picture_resize: Literal["area"] = "area"
    mask_resize: Literal["all", "nearest"] = "all"


class Masks(Document):
    """What is not scored, besides pixels that the lens does not see.

    Attributes:
        ego: the vehicle itself, by the rig's static masks and mask layers of kind ``ego``.
        dynamic: where road users' pixels are taken from, the first that a traversal has: ``masks`` (layers of kind
            ``dynamic``) or ``boxes`` (hulls of projected 3D boxes). Empty: they are scored.
        categories: of boxes; None: all.
        sky: mask layers of kind ``sky`` too.
    """

    ego: bool
    dynamic: tuple[Literal["masks", "boxes"], ...]
    categories: tuple[str, ...] | None = None
    sky: bool = False


class Vehicles(Document):
    """Which vehicles are edited, and which pictures show enough of them.

    Attributes:
        categories: of boxes.
        choose: ``all`` of them, or per frame the ``nearest`` one.
        min_area_px: a picture counts where a chosen vehicle's projected bounds have so many pixels of the final raster.
        max_distance_m: farther ones are left alone.
        visible_share: a picture counts where at least this share of a vehicle's bounds lies in the raster.
    """

    categories: tuple[str, ...] = Field(min_length=1)
    choose: Literal["all", "nearest"]
    min_area_px: float = Field(gt=0)
    max_distance_m: float = Field(gt=0)
    visible_share: float = Field(default=0.5, gt=0, le=1)


class Psnr(Document):
    """Peak signal-to-noise ratio of the selected pixels, peak 255; equal pictures are infinite and counted apart."""

    metric: Literal["psnr"]


class PsnrCc(Document):
    """PSNR after the quadratic colour warp of MTGS (the paper's PSNR*): ``iterations`` fits on unclipped pixels."""

    metric: Literal["psnr_cc"]
    iterations: int = Field(default=5, ge=1)


class Ssim(Document):
    """Structural similarity: window and border by ``preset``, masked by ``mask``."""

    metric: Literal["ssim"]
    preset: Literal["gaussian11", "uniform7", "torchmetrics", "3dgs"]
    mask: Literal["map", "erode", "normalised"]


class Lpips(Document):
    """Learned perceptual similarity; what is not scored is black in both pictures, or left out of the map's mean."""

    metric: Literal["lpips"]
    net: Literal["alex", "vgg", "squeeze"]
    mask: Literal["zero-fill", "map"]


class Fid(Document):
    """Frechet distance of Inception features: ``mode`` of resizing; a warning below ``warn_below`` pictures."""

    metric: Literal["fid"]
    mode: Literal["clean", "tf1"]
    warn_below: int = Field(default=2048, ge=2)


class Kid(Document):
    """Kernel distance of the same features, unbiased."""

    metric: Literal["kid"]
    mode: Literal["clean", "tf1"]


class Fvd(Document):
    """Frechet distance of I3D features of clips of ``frames`` pictures, squeezed or cropped to 224 x 224."""

    metric: Literal["fvd"]
    frames: int = Field(ge=9)
    crop: Literal["squeeze", "centre"]
    ddof: Literal[0, 1]


class EditIou(Document):
    """IoU of an edited region with its target box.

    ``hull``: the region against the box's convex hull. ``box``: their tight upright rectangles. ``ceiling``: the region
    against the hull's rectangle, as a share of what the hull itself reaches, since no vehicle fills its rectangle.
    """

    metric: Literal["edit_iou"]
    variant: Literal["hull", "box", "ceiling"]


class Detection(Document):
    """nuScenes detection figures: AP over distances of centres, true-positive errors, NDS.

    Attributes:
        metric: tag.
        absent: classes that no true box has: ``present`` leaves them out, ``devkit`` counts them as 0.
        class_range_m: classes, and up to which distance from the ego each is judged.
        max_boxes_per_frame: more are refused.
    """

    metric: Literal["nuscenes_detection"]
    absent: Literal["present", "devkit"]
    class_range_m: dict[str, float]
    max_boxes_per_frame: int = Field(default=500, ge=1, le=10_000)


class ReportedFigure(Document):
    """A figure that the submission's manifest states, and that is measured again where the method is installed."""

    metric: Literal["frames_per_second", "model_bytes_per_100m", "training_s", "peak_memory_bytes"]


Metric = Annotated[
    Psnr | PsnrCc | Ssim | Lpips | Fid | Kid | Fvd | EditIou | Detection | ReportedFigure, Field(discriminator="metric")
]


class Intervals(Document):
    """Confidence intervals by resampling blocks of consecutive frames.

    Attributes:
        level: of confidence.
        resamples: how many, of means of pictures.
        set_resamples: how many, of distances between sets, each of which takes seconds.
        block_frames: frames a block; all cameras of a frame stay together.
        seed: of the draw.
    """

    level: float = Field(default=0.95, gt=0, lt=1)
    resamples: int = Field(default=1000, ge=100, le=100_000)
    set_resamples: int = Field(default=50, ge=20, le=10_000)
    block_frames: int = Field(default=5, ge=1)
    seed: int = 0


class Protocol(Document):
    """One protocol.

    Attributes:
        name: what it is called by.
        version: counted up with every change of what is measured.
        description: what it is; no part of the hash.
        task: the scorer.
        groups: what is scored together.
        frames: which.
        pixels: in which raster.
        masks: what is not scored.
        vehicles: which are edited; None: none.
        metrics: what is measured.
        averaging: means are taken over pictures within each of these, then over those; ``("traversal", "scene")`` is
            MTGS's order, ``("scene",)`` OmniRe's.
        intervals: of confidence.
    """

    name: Identifier
    version: int = Field(ge=1)
    description: str
    task: ScoringTask
    groups: tuple[Group, ...] = Field(min_length=1)
    frames: Frames
    pixels: Pixels
    masks: Masks
    vehicles: Vehicles | None = None
    metrics: tuple[Metric, ...] = Field(min_length=1)
    averaging: tuple[Literal["traversal", "scene"], ...]
    intervals: Intervals = Intervals()

    @model_validator(mode="after")
    def _consistent(self) -> Protocol:
        for what, names in (("group", [one.name for one in self.groups]), ("metric", list(self.metric_names))):
            repeated = sorted({name for name in names if names.count(name) > 1})
            if repeated:
                raise ValueError(f"{what} {repeated[0]!r} is there twice")
        edits = any(one.vehicle_shift_m is not None or one.without_vehicles for one in self.groups)
        if edits and self.vehicles is None:
            raise ValueError("groups edit vehicles, but [vehicles] does not say which")
        return self

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the figures, one a metric."""
        return tuple(metric_name(metric) for metric in self.metrics)

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical content: all but the description."""
        plain = self.model_dump(mode="json", exclude={"description"})
        return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def metric_name(metric: Metric) -> str:
    """What a metric's figure is called: its own name, and what distinguishes it from its like."""
    if isinstance(metric, EditIou):
        return f"edit_iou_{metric.variant}"
    if isinstance(metric, Lpips):
        return f"lpips_{metric.net}"
    return metric.metric


def protocol_names() -> list[str]:
    """The protocols that come with the toolkit."""
    folder = files("mirror.protocols").joinpath("definitions")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_protocol(name: str) -> Protocol:
    """A protocol by name, or of a file: a path that ends in ``.toml``.

    Raises:
        UsageError: there is none of that name, or the name is reserved.
        SchemaError: the file is wrong; the key is named.

    Example:
        >>> protocol = mirror.load_protocol("lane-shift")
        >>> protocol.name
        'lane-shift'
    """
    if name.endswith(".toml"):
        path = Path(name)
        try:
            return parse_protocol(path.read_bytes(), str(path))
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}", file=path, expected="a protocol's TOML") from error
    known = protocol_names()
    if name in RESERVED:
        raise UsageError(f"the name {name!r} is reserved: {RESERVED[name]}", expected=f"one of {', '.join(known)}")
    if name not in known:
        raise UsageError(
            f"no protocol {name!r}", expected=f"one of {', '.join(known)}, or the path of a protocol's .toml"
        )
    return parse_protocol(
        files("mirror.protocols").joinpath("definitions", f"{name}.toml").read_bytes(), f"{name}.toml"
    )


def parse_protocol(data: bytes, file: str) -> Protocol:
    """A protocol of its TOML.

    Raises:
        SchemaError: not TOML, or a key is wrong; it is named.
    """
    try:
        return Protocol.model_validate(tomllib.loads(data.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SchemaError(f"not TOML ({error})", file=file, expected="a protocol") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise SchemaError(
            f"{first['msg']} (got {first.get('input')!r:.80})",
            file=file,
            place=".".join(str(part) for part in first["loc"]) or "the whole protocol",
            expected="a protocol as docs/evaluation.md describes it",
        ) from error
