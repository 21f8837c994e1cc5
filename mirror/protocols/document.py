"""Protocols as data (TOML, hashed): which views a submission must render, and how the renders are scored."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import SchemaError, UsageError
from mirror.geometry.cameras import WIDEST_DEG
from mirror.protocols.metrics import Metric, figure_names, metric_name
from mirror.protocols.ranking import Ranking
from mirror.protocols.rectangle import Rectangle
from mirror.protocols.suite import Suite
from mirror.schema.documents import Document, Identifier, Role
from mirror.schema.hashing import HashStyle, hash_document
from mirror.schema.problems import describe_problems
from mirror.schema.strict_toml import TomlError, decode_toml

ScoringTask = Literal[
    "reconstruction",
    "lane-shift",
    "vehicle-translation",
    "generation",
    "editing-accuracy",
    "annotation",
    "runtime",
    "safety",
]
_UNMASKED: Final = "-unmasked"
Slug = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.\-]{0,39}$")]


class Group(Document):
    """A group of renders that are scored together: one column of a result table.

    Attributes:
        name: name of the group; the first folder in the paths of its renders.
        roles: split roles of the traversals in the group.
        ego_shift_m: shift of the cameras along the ego's y axis, in metres; positive is to the left.
        vehicle_shift_m: shift of the selected vehicles along their own y axis, in metres, positive to the left;
            None: no vehicle is moved.
        without_vehicles: whether the selected vehicles are removed, so that the background behind them is rendered.
    """

    name: Slug
    roles: tuple[Role, ...] = Field(min_length=1)
    ego_shift_m: float = 0.0
    vehicle_shift_m: float | None = None
    without_vehicles: bool = False

    @model_validator(mode="after")
    def _one_edit(self) -> Group:
        if self.without_vehicles and self.vehicle_shift_m is not None:
            raise ValueError("a group either moves vehicles or removes them, not both")
        return self


class Frames(Document):
    """The frames of a traversal that are rendered.

    Attributes:
        every: step between rendered frames (MTGS: 5, which is 10 Hz to 2 Hz; OmniRe for novel views: 10).
        first: index of the first rendered frame. The hash omits it if it is 0.
        last: whether the last frame of the traversal is rendered too, as in MTGS.
        cameras: names of the rendered cameras; None: all cameras of the rig.
    """

    every: int = Field(ge=1)
    first: int = Field(default=0, ge=0, exclude_if=lambda first: first == 0)
    last: bool
    cameras: tuple[str, ...] | None = None


class Pixels(Document):
    """The raster in which renders are compared.

    Attributes:
        space: ``raw``: the camera's own lens. ``undistorted``: a pinhole at the same position with a raster of the same
            size that contains everything the lens sees (OpenCV's alpha = 1, as in MTGS).
        widest_deg: for ``undistorted``: largest angle from the optical axis, in degrees. Without a limit the centre of
            a fisheye image would shrink to a few pixels.
        max_width_px: wider rasters are scaled down to this width with the same aspect ratio; none is enlarged.
        shutter: ``global``: views are rendered at mid-exposure. ``calibrated``: each row or column is rendered at its
            own time, where the calibration of the recorded image has a rolling shutter. The hash omits ``global``.
        picture_resize: how images are scaled. ``area``: each pixel is the mean of the pixels that it covers.
        mask_resize: how masks are scaled. ``all``: a pixel is scored if all pixels that it covers are scored.
            ``nearest``: a pixel is scored if the pixel at its centre is, as in MTGS.
    """

    space: Literal["raw", "undistorted"]
    widest_deg: float = Field(default=WIDEST_DEG, gt=0, lt=89)
    max_width_px: int = Field(ge=16, le=8192)
    shutter: Literal["global", "calibrated"] = Field(default="global", exclude_if=lambda shutter: shutter == "global")
    picture_resize: Literal["area"] = "area"
    mask_resize: Literal["all", "nearest"] = "all"


class Masks(Document):
    """The pixels that are not scored. Pixels outside the lens's field of view are never scored.

    Attributes:
        ego: exclude the ego vehicle, by the rig's static masks and mask layers of kind ``ego``.
        dynamic: sources of road users' pixels, in order of preference; the first one that a traversal has is used:
            ``masks`` (layers of kind ``dynamic``) or ``boxes`` (hulls of projected 3D boxes). Empty: road users are
            scored.
        categories: box categories that are excluded; None: all.
        sky: exclude the sky, by mask layers of kind ``sky``.
    """

    ego: bool
    dynamic: tuple[Literal["masks", "boxes"], ...]
    categories: tuple[str, ...] | None = None
    sky: bool = False


class Vehicles(Document):
    """The vehicles that are edited, and the part of one that a view must show.

    Attributes:
        categories: box categories of the vehicles.
        choose: ``all``: every vehicle. ``nearest``: the nearest vehicle in each frame.
        min_area_px: a view is requested only if the projected bounds of a selected vehicle cover at least this many
            pixels of the final raster.
        max_distance_m: vehicles that are farther than this are not edited.
        visible_share: a view is requested only if at least this share of a vehicle's bounds lies inside the raster.
    """

    categories: tuple[str, ...] = Field(min_length=1)
    choose: Literal["all", "nearest"]
    min_area_px: float = Field(gt=0)
    max_distance_m: float = Field(gt=0)
    visible_share: float = Field(default=0.5, gt=0, le=1)


class Intervals(Document):
    """Confidence intervals by resampling blocks of consecutive frames.

    Attributes:
        level: confidence level.
        resamples: number of resamples for means over images.
        set_resamples: number of resamples for distances between sets; each takes seconds.
        block_frames: frames in a block; all cameras of a frame stay in the same block.
        seed: seed of the resampling.
    """

    level: float = Field(default=0.95, gt=0, lt=1)
    resamples: int = Field(default=1000, ge=100, le=100_000)
    set_resamples: int = Field(default=50, ge=20, le=10_000)
    block_frames: int = Field(default=5, ge=1)
    seed: int = 0


class Protocol(Document):
    """A protocol: requested views, raster, masks, metrics and averaging.

    Attributes:
        name: name of the protocol.
        version: increased with every change that affects figures.
        description: description for readers; not part of the hash.
        task: task, which selects the scorer.
        groups: groups of renders that are scored together.
        frames: frames that are rendered.
        pixels: raster of the renders.
        masks: pixels that are not scored.
        vehicles: vehicles that are edited; None: none.
        fitted_part: the only part of held-out images that an appearance may be fitted to. A submission with a fitted
            appearance is scored on the rest, in every group. None: no appearance may be fitted. The hash omits None.
        suite: drives that a policy is asked for; None: rollouts are scored whatever they are of. The hash omits None.
        metrics: metrics that are computed.
        ranking: the figure that ranks results; None: the protocol ranks nothing. The hash omits None.
        averaging: levels of the mean, innermost first: image values are averaged within each part of the first level,
            these means within the next. ``("traversal", "scene")`` is the order of MTGS, ``("scene",)`` of OmniRe.
        intervals: settings of the confidence intervals.
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
    fitted_part: Rectangle | None = Field(default=None, exclude_if=lambda part: part is None)
    suite: Suite | None = Field(default=None, exclude_if=lambda suite: suite is None)
    metrics: tuple[Metric, ...] = Field(min_length=1)
    ranking: Ranking | None = Field(default=None, exclude_if=lambda ranking: ranking is None)
    averaging: tuple[Literal["traversal", "scene"], ...]
    intervals: Intervals = Intervals()

    @model_validator(mode="after")
    def _consistent(self) -> Protocol:
        for kind, names in (("group", [group.name for group in self.groups]), ("metric", list(self.metric_names))):
            repeated = sorted({name for name in names if names.count(name) > 1})
            if repeated:
                raise ValueError(f"{kind} {repeated[0]!r} is listed twice")
        edits = any(group.vehicle_shift_m is not None or group.without_vehicles for group in self.groups)
        if edits and self.vehicles is None:
            raise ValueError("groups edit vehicles, but there is no table [vehicles] that selects them")
        if self.suite is not None and self.task != "safety":
            raise ValueError(f"a suite of drives in a protocol of the task {self.task!r}, not 'safety'")
        self._require_known_ranking()
        return self

    def _require_known_ranking(self) -> None:
        if self.ranking is None:
            return
        groups = [group.name for group in self.groups]
        unknown = [name for name in self.ranking.groups if name not in groups]
        if unknown or len(set(self.ranking.groups)) < len(self.ranking.groups):
            raise ValueError(f"ranking.groups must be different groups of {', '.join(groups)}")
        figures = [name for metric in self.metrics for name in figure_names(metric)]
        named = [self.ranking.metric] if self.ranking.gate is None else [self.ranking.metric, self.ranking.gate.metric]
        for name in named:
            if name not in figures:
                raise ValueError(f"the ranking names {name!r}; the metrics give {', '.join(figures)}")

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the figures, one for each metric."""
        return tuple(metric_name(metric) for metric in self.metrics)

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical content without the description."""
        plain = self.model_dump(mode="json", exclude={"description"})
        return hash_document(plain, HashStyle.CANONICAL)


def commit_to_secret(protocol: Protocol, commitment: str) -> Protocol:
    """Return the protocol of a test split: a suite's protocol with the commitment to a secret in place of its seed.

    Args:
        protocol: a protocol whose suite draws parameters.
        commitment: SHA-256 of the secret.

    Raises:
        UsageError: the protocol has no suite that draws.
    """
    suite = protocol.suite
    if suite is None or suite.draw is None:
        raise UsageError(f"protocol {protocol.name} draws nothing", expected="a suite with a table draw")
    draw = suite.draw.model_copy(update={"seed": None, "commitment": commitment})
    return protocol.model_copy(update={"suite": suite.model_copy(update={"draw": draw})})


def protocol_names() -> list[str]:
    """List the names of the protocols that come with the toolkit, sorted."""
    folder = files("mirror.protocols").joinpath("definitions")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def read_definition(name: str) -> bytes:
    """Read the TOML of a protocol that comes with the toolkit.

    Raises:
        UsageError: no protocol has that name.
    """
    known = protocol_names()
    if name not in known:
        raise UsageError(
            f"no protocol {name!r}", expected=f"one of {', '.join(known)}, or the path of a protocol's .toml"
        )
    return files("mirror.protocols").joinpath("definitions", f"{name}.toml").read_bytes()


def load_protocol(name: str, *, masked: bool = True) -> Protocol:
    """Load a protocol by its name, or from a path that ends in ``.toml``.

    Args:
        name: name or path.
        masked: False: load the protocol that does not mask road users and agrees with this one in everything else.

    Raises:
        UsageError: no protocol has that name, none agrees with it without masks, or the file cannot be read.
        SchemaError: the file is invalid; the message names the key.

    Example:
        >>> protocol = mirror.load_protocol("lane-shift")
        >>> protocol.name
        'lane-shift'
    """
    if name.endswith(".toml"):
        path = Path(name)
        try:
            protocol = parse_protocol(path.read_bytes(), str(path))
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}", file=path, expected="a protocol's TOML") from error
    else:
        protocol = parse_protocol(read_definition(name), f"{name}.toml")
    if masked or not protocol.masks.dynamic:
        return protocol
    sibling = f"{name}{_UNMASKED}"
    if sibling not in protocol_names():
        shown = name if name in protocol_names() else f"static-reconstruction{_UNMASKED}"
        raise UsageError(
            f"protocol {name} masks road users, and no protocol of the toolkit is the same without masks",
            place="--no-masks",
            expected=" or ".join(one.removesuffix(_UNMASKED) for one in protocol_names() if one.endswith(_UNMASKED)),
            remedy=f"`mirror protocols show {shown} > mine.toml`, write dynamic = [] under [masks] and another name, "
            "and give --protocol mine.toml",
        )
    return load_protocol(sibling)


def format_file_option(protocol: str) -> str:
    """Format the option that names a protocol's file to a verb that reads a submission, with a space before it.

    Args:
        protocol: value of --protocol; of a name, which the submission's manifest has too, the text is empty.
    """
    return f" --protocol {protocol}" if protocol.endswith(".toml") else ""


def parse_protocol(data: bytes, file: str) -> Protocol:
    """Parse the TOML of a protocol.

    Args:
        data: bytes of the TOML.
        file: file name for error messages.

    Raises:
        SchemaError: the data is not TOML, or a key is invalid; the message names the key.
    """
    try:
        return Protocol.model_validate(decode_toml(data))
    except TomlError as error:
        raise SchemaError(f"not TOML ({error})", file=file, expected="a protocol") from error
    except ValidationError as error:
        problem, place = describe_problems(error.errors(), "the whole protocol")
        raise SchemaError(
            problem,
            file=file,
            place=place,
            expected="a protocol as docs/evaluation/protocols.md describes it",
        ) from error
