"""The options with which a COLMAP model is read as a recording: a model states neither time nor scale nor place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.errors import RecordingError
from mirror.geometry.geodesy import TangentFrame
from mirror.recordings.paths import to_identifier
from mirror.recordings.readers.collection import one_of

OPTIONS: Final = ("model", "images", "stamps", "rate_hz", "scale", "up", "origin", "frame")


@dataclass(frozen=True)
class ColmapSettings:
    """The options of a COLMAP recording.

    Attributes:
        images: folder of the images.
        stamps: where times come from: ``name``, ``order``, or ``auto``.
        rate_hz: rate of images without times.
        scale: metres for each unit of the model.
        up: what points up: ``z``, or the mean of the ``images``.
        origin: place of the model's origin on the globe; None: the model keeps its own frame.
        frame: name of that frame; None: it is named by the folder.
    """

    images: str
    stamps: str
    rate_hz: float
    scale: float
    up: str
    origin: TangentFrame | None
    frame: str | None


def read_settings(options: Mapping[str, str], path: Path) -> ColmapSettings:
    """Read and check the options.

    Raises:
        RecordingError: an option has a value that cannot be used; the option is named.
    """
    origin = None
    if "origin" in options:
        try:
            longitude, latitude, height = (float(word) for word in options["origin"].split(","))
            if not (abs(longitude) <= 180.0 and abs(latitude) <= 90.0 and abs(height) < 1e5):
                raise ValueError("not a place on the globe")
        except ValueError as error:
            raise RecordingError(
                f"origin={options['origin']!r:.80} ({error})",
                file=path,
                place="option origin",
                expected="longitude,latitude,height in degrees and metres",
            ) from error
        origin = TangentFrame(longitude, latitude, height)
    return ColmapSettings(
        images=options.get("images", "images"),
        stamps=one_of(options, "stamps", ("auto", "name", "order"), path),
        rate_hz=_positive(options, "rate_hz", path),
        scale=_positive(options, "scale", path),
        up=one_of(options, "up", ("z", "images"), path),
        origin=origin,
        frame=to_identifier(options["frame"]) if "frame" in options else None,
    )


def _positive(options: Mapping[str, str], name: str, path: Path) -> float:
    try:
        value = float(options.get(name, "1"))
    except ValueError:
        value = 0.0
    if not 1e-6 <= value <= 1e6:
        raise RecordingError(
            f"{name}={options[name]!r:.80}", file=path, place=f"option {name}", expected="a number from 1e-6 to 1e6"
        )
    return value
