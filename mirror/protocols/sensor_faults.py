"""Faults of sensors that a suite has by name, with their strengths."""

from __future__ import annotations

from pydantic import Field

from mirror.schema.documents import Document, Identifier


class SensorFault(Document):
    """A fault of the sensors: how the images that a policy gets differ from those of a sound rig.

    The lens and mounting in the policy's specification are those of the sound rig. Strengths of 0 change nothing.

    Attributes:
        name: its name.
        exposure_stops: change of the exposure, in powers of two; above 0 is brighter. Light is taken as linear in the
            2.2th power of a pixel.
        noise: standard deviation of Gaussian noise that is added to each pixel, in steps of 8 bits.
        dropped: cameras whose images are black.
        late_steps: number of steps that images are late; before the first one arrives, images are black.
        turned_deg: turn of all cameras about the vehicle's upward axis; positive is to the left.
        after_s: time of the drive from which dropped cameras are black.
    """

    name: Identifier
    exposure_stops: float = Field(default=0.0, ge=-8, le=8)
    noise: float = Field(default=0.0, ge=0, le=128)
    dropped: tuple[str, ...] = ()
    late_steps: int = Field(default=0, ge=0, le=50)
    turned_deg: float = Field(default=0.0, ge=-45, le=45)
    after_s: float = Field(default=0.0, ge=0, le=3600)
