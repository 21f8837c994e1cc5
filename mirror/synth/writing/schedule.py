"""The exposure times of a drive's images, true and recorded, and the images that were lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Int64
from mirror.synth.errors import CameraClock, Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.seeds import random_stream

_SETTLED_S: Final = 0.3


@dataclass(frozen=True, eq=False)
class ImageSchedule:
    """The exposure times of a drive's images, N images of each camera.

    Attributes:
        true_ns: (N,) by camera name: true mid-exposure times.
        recorded_ns: (N,) by camera name: mid-exposure times that the recording states.
        kept: (N,) by camera name: False where the image was lost.
        clocks: clock of each camera, by camera name.
    """

    true_ns: Mapping[str, Int64]
    recorded_ns: Mapping[str, Int64]
    kept: Mapping[str, Bool]
    clocks: Mapping[str, CameraClock]

    def __len__(self) -> int:
        return len(next(iter(self.true_ns.values())))

    def following(self, camera: str, number: int) -> int | None:
        """Return the true mid-exposure of the camera's next image that was not lost; None if there is no next one."""
        later = np.flatnonzero(self.kept[camera][number + 1 :])
        return int(self.true_ns[camera][number + 1 + later[0]]) if len(later) else None


def schedule_images(drive: SynthDrive, errors: Errors) -> ImageSchedule:
    """Schedule the images of a drive, all between the first and the last pose."""
    kind, cameras = drive.vehicle.kind, tuple(drive.vehicle.cameras)
    time_s = np.arange(_SETTLED_S, drive.truth.duration_s - _SETTLED_S, 1.0 / drive.preset.image_hz)
    instants = drive.condition.start_ns + np.round(time_s * 1e6).astype(np.int64) * 1000
    clocks = errors.draw_clocks(cameras, random_stream("clocks", drive.seed, 2))
    rng = random_stream("losses", drive.seed, 3)
    true, recorded, kept = {}, {}, {}
    for place, name in enumerate(cameras):
        true[name] = instants + place * kind.stagger_ns
        recorded[name] = true[name] + clocks[name].error_ns
        kept[name] = ~errors.draw_losses(len(instants), rng)
    if drive.recipe.lost is not None and errors != Errors.none():
        name, number = drive.recipe.lost
        kept[name][number : number + 1] = False
    return ImageSchedule(true, recorded, kept, clocks)
