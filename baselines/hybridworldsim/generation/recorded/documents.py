"""The documents beside clips: what each traversal gave, and the statistics of the whole folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field

from mirror.schema.documents import Document

SIZES: Final = ((0.0, "below 1 %"), (0.01, "1 to 5 %"), (0.05, "5 % and more"))
"""Least share of a view that a road user covers, by the name of the size."""
HIDDEN: Final = ((0.0, "below 10 %"), (0.1, "10 to 25 %"), (0.25, "25 to 50 %"), (0.5, "50 % and more"))
"""Least share of training images that hide a place, by the name of the class."""
UNKNOWN: Final = "not known"


class BackgroundError(Document):
    """The error of backgrounds against recorded images, outside the masks.

    Attributes:
        pixels: number of pixels.
        square: sum of their mean squares of the three colours, in 255ths squared.
    """

    pixels: int = 0
    square: float = 0.0

    @property
    def psnr_db(self) -> float:
        """The PSNR, dB; NaN without pixels."""
        if not self.pixels:
            return float("nan")
        return -10.0 * float(np.log10(max(self.square / self.pixels, 1e-9) / 255.0**2))

    def __add__(self, other: BackgroundError) -> BackgroundError:
        return BackgroundError(pixels=self.pixels + other.pixels, square=self.square + other.square)


class ClipCounts(Document):
    """Counts of clips.

    Attributes:
        windows: number of windows.
        frames: number of frames.
        seconds: length of all windows.
        tracks: road users by class; one that several windows of a traversal show counts once in it.
        shown: views that show a road user, by class and by its size in the view, see `SIZES`.
        excluded: share of pixels that training does not use.
        masked: share of pixels that show a road user with a box.
        errors: errors of backgrounds, by the share of training images that hide the place, see `HIDDEN`.
    """

    windows: int = 0
    frames: int = 0
    seconds: float = 0.0
    tracks: dict[str, int] = Field(default_factory=dict)
    shown: dict[str, dict[str, int]] = Field(default_factory=dict)
    excluded: float = 0.0
    masked: float = 0.0
    errors: dict[str, BackgroundError] = Field(default_factory=dict)

    @property
    def error(self) -> BackgroundError:
        """The error in all pixels outside the masks."""
        return sum(self.errors.values(), BackgroundError())


class WindowCounts(Document):
    """Counts of the windows of frames that were considered for clips.

    Attributes:
        candidates: windows of consecutive frames.
        standing: those in which the vehicle moves too little.
        lacking: those that lack too many images or masks.
        quiet: those in which too few frames show a road user.
        unknown_boxes: boxes of categories that the generator does not know, in the frames of the clips, by category.
    """

    candidates: int
    standing: int
    lacking: int
    quiet: int
    unknown_boxes: dict[str, int]


class TraversalClips(WindowCounts):
    """``traversals/<id>.json``: the clips of a finished traversal, and the counts of its windows.

    Attributes:
        format: always ``mirror-traversal-clips``.
        version: version of this document.
        traversal: the traversal.
        rate_hz: frames per second.
        clips: ids of the clips.
        counts: counts of the clips.
    """

    format: Literal["mirror-traversal-clips"] = "mirror-traversal-clips"
    version: Literal["1"] = "1"
    traversal: str
    rate_hz: float
    clips: tuple[str, ...]
    counts: ClipCounts


class ClipStatistics(WindowCounts):
    """``statistics.json``: statistics of the clips of a folder, the counts of all windows, and their sources.

    Attributes:
        format: always ``mirror-clip-statistics``.
        version: version of this document.
        traversals: number of traversals that gave clips.
        counts: counts of all clips.
        weights: the rule by which training weighs pixels.
        inputs: everything that determines the clips.
    """

    format: Literal["mirror-clip-statistics"] = "mirror-clip-statistics"
    version: Literal["1"] = "1"
    traversals: int
    counts: ClipCounts
    weights: str
    inputs: dict[str, Any]


def join_counts(parts: Sequence[ClipCounts]) -> ClipCounts:
    """Return the counts of several sets of clips together; shares are averaged with weights by frames."""
    frames = sum(one.frames for one in parts)

    def mean(name: str) -> float:
        return sum(getattr(one, name) * one.frames for one in parts) / max(frames, 1)

    errors: dict[str, BackgroundError] = {}
    shown: dict[str, dict[str, int]] = {}
    for one in parts:
        for name, error in one.errors.items():
            errors[name] = errors.get(name, BackgroundError()) + error
        for name, sizes in one.shown.items():
            shown[name] = join_numbers([shown.get(name, {}), sizes])
    return ClipCounts(
        windows=sum(one.windows for one in parts),
        frames=frames,
        seconds=sum(one.seconds for one in parts),
        tracks=join_numbers([one.tracks for one in parts]),
        shown=shown,
        excluded=mean("excluded"),
        masked=mean("masked"),
        errors=errors,
    )


def join_numbers(parts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    """Return the sums of numbers by name."""
    names = dict.fromkeys(name for one in parts for name in one)
    return {name: sum(one.get(name, 0) for one in parts) for name in names}
