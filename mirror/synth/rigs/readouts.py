"""The option ``--rolling-shutter``: the direction and readout of each camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from mirror.errors import UsageError
from mirror.geometry.rolling_shutter import SHUTTER_DIRECTIONS
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.rigs.vehicle import CameraReadout

OPTION: Final = "--rolling-shutter"
_FORM: Final = "DIRECTION:MILLISECONDS for all cameras, or CAMERA=DIRECTION:MILLISECONDS,..."


def parse_readouts(text: str) -> tuple[CameraReadout, ...]:
    """Parse readouts, such as ``top_to_bottom:30`` or ``front_wide=top_to_bottom:30,rear=left_to_right:12.5``.

    Raises:
        UsageError: a camera or direction does not exist, a camera is named twice, or a readout is no positive number.
    """
    readouts: dict[str, CameraReadout] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        camera, equals, shutter = part.rpartition("=")
        direction, colon, milliseconds = shutter.partition(":")
        if not colon:
            raise UsageError(f"no readout in {part!r}", place=OPTION, expected=_FORM)
        if direction not in SHUTTER_DIRECTIONS or direction == "global":
            expected = " or ".join(name for name in SHUTTER_DIRECTIONS if name != "global")
            raise UsageError(f"no direction {direction!r}", place=OPTION, expected=expected)
        if equals and camera not in CANONICAL_CAMERAS:
            raise UsageError(f"no camera {camera!r}", place=OPTION, expected=" or ".join(CANONICAL_CAMERAS))
        readout_ns = _to_ns(milliseconds)
        for name in (camera,) if equals else CANONICAL_CAMERAS:
            if name in readouts:
                raise UsageError(f"two shutters of camera {name}", place=OPTION, expected="one of each camera")
            readouts[name] = CameraReadout(name, direction, readout_ns)
    return tuple(readouts.values())


def require_shorter(readouts: Sequence[CameraReadout], image_hz: float) -> None:
    """Require that each readout ends before the next image begins.

    Raises:
        UsageError: a readout is longer than the period of the frames.
    """
    period_ns = 1e9 / image_hz
    for readout in readouts:
        if readout.readout_ns > period_ns:
            raise UsageError(
                f"camera {readout.camera} is read out in {readout.readout_ns * 1e-6:g} ms",
                place=OPTION,
                expected=f"at most the period of its frames, {period_ns * 1e-6:g} ms at {image_hz:g} images a second",
            )


def _to_ns(milliseconds: str) -> int:
    try:
        value = float(milliseconds)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise UsageError(f"a readout of {milliseconds!r}", place=OPTION, expected="milliseconds above 0")
    return round(value * 1e6)
