"""The report of `mirror poses`: for each part of the drive its images, errors, scale and distances from the track."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mirror.localisation.structure.maps import ImageMap
from mirror.localisation.structure.used_images import UsedImages
from mirror.recordings.time import SECOND_NS


@dataclass(frozen=True)
class PartReport:
    """One part of a drive.

    Attributes:
        recording: folder of its recording.
        images: number of registered images.
        first_ns: time of the first one.
        last_ns: time of the last one.
        way_m: length of the way.
        residual_px: mean distance of features from the projections of their points.
        points: number of points.
        scale: where the scale comes from, in words.
        scale_sigma_percent: 1-sigma of the scale, percent; None: the given number is taken as exact.
        lens: the lens, in words.
        mounting: the mounting, in words.
        camera_height_m: height of the camera above the road; None: too few points of the road were driven over.
        track_rms_m: root mean square of the horizontal distances from the track after the similarity alone; None: there
            is no track.
        adjusted_rms_m: the same after the adjustment to the track; None: there was none.
        track_end_m: distance from the track at the end of the part, when the map is laid on its first third; None.
    """

    recording: Path
    images: int
    first_ns: int
    last_ns: int
    way_m: float
    residual_px: float
    points: int
    scale: str
    scale_sigma_percent: float | None
    lens: str
    mounting: str
    camera_height_m: float | None
    track_rms_m: float | None = None
    adjusted_rms_m: float | None = None
    track_end_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the report, for JSON."""
        return asdict(self) | {"recording": str(self.recording)}


@dataclass
class PosesReport:
    """The result of `mirror poses` for one recording.

    Attributes:
        source: the recording.
        camera: the camera that was registered.
        read: number of its images.
        used: number of images between which the image moves.
        matched: number of matched pairs of images.
        parts: the parts of the drive that were written.
        refused: parts that were not, with the reason.
        bridged_s: gaps between registered images within parts, seconds.
        hidden: number of images with masks or boxes of road users.
    """

    source: Path
    camera: str
    read: int = 0
    used: int = 0
    matched: int = 0
    parts: list[PartReport] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    bridged_s: list[float] = field(default_factory=list)
    hidden: int = 0

    @property
    def registered(self) -> int:
        """Number of registered images."""
        return sum(part.images for part in self.parts)

    @property
    def share(self) -> float:
        """Registered share of the used images."""
        return self.registered / self.used if self.used else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the report, for JSON."""
        plain = {**vars(self), "source": str(self.source), "registered": self.registered, "share": self.share}
        return plain | {"parts": [part.to_dict() for part in self.parts]}

    def lines(self) -> list[str]:
        """Return the report in words."""
        lines = [
            f"{self.source}: camera {self.camera}: {self.used} of {self.read} images are used, "
            f"{self.registered} of them registered ({self.share:.1%})"
        ]
        if self.hidden:
            lines.append(f"  road users are hidden in {self.hidden} images")
        if self.bridged_s:
            lines.append(f"  gaps bridged: {', '.join(f'{gap:.1f} s' for gap in self.bridged_s)}")
        if len(self.parts) > 1:
            lines.append(f"  the drive is cut into {len(self.parts)} parts, between which no image could be registered")
        for part in self.parts:
            lines += [
                f"  {part.recording}: {part.images} images, {part.way_m:.1f} m, {part.points} points,"
                f" {part.residual_px:.2f} px",
                f"    scale: {part.scale}"
                + (f" (+- {part.scale_sigma_percent:.1f} %)" if part.scale_sigma_percent is not None else ""),
                f"    lens: {part.lens}; mounting: {part.mounting}",
            ]
            if part.track_rms_m is not None:
                end = f", {part.track_end_m:.2f} m at its end if laid on its first third" if part.track_end_m else ""
                after = f"; {part.adjusted_rms_m:.2f} m after the adjustment" if part.adjusted_rms_m is not None else ""
                lines.append(f"    distance from the track: {part.track_rms_m:.2f} m rms{end}{after}")
        return [*lines, *(f"  refused: {text}" for text in self.refused)]


def describe_part(images: UsedImages, part: ImageMap) -> str:
    """Return the number of images of a part and its seconds since the first used image, for messages."""
    first = int(images.time_ns[0])
    begin, end = ((int(images.time_ns[part.used[place]]) - first) / SECOND_NS for place in (0, -1))
    return f"{len(part.used)} images from {begin:.1f} to {end:.1f} s"
