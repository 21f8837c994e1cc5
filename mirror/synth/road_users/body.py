"""Road users: a body, a motion and an id."""

from __future__ import annotations

from dataclasses import dataclass

from mirror.synth.model import Model
from mirror.traffic.placement.motion import Motion, Placement


@dataclass(frozen=True, eq=False)
class Body:
    """Shape of a road user in its own frame: x forward, y left, z up, origin on the ground below its centre.

    Attributes:
        category: class of its 3D boxes.
        size_m: length, width and height of its 3D box, which stands on the origin.
        model: its faces, which stay within the box to 1 mm.
    """

    category: str
    size_m: tuple[float, float, float]
    model: Model

    def model_at(self, placement: Placement) -> Model:
        """Return the model in the pose of a placement, within the box: only people change their shape."""
        return self.model


def make_body(category: str, model: Model) -> Body:
    """Make a body from a model: compute its bounding box and move the origin below the box's middle."""
    low, high = model.bounds()
    middle = 0.5 * (low[0] + high[0])
    size = float(high[0] - low[0]), 2.0 * float(max(high[1], -low[1])), float(high[2])
    return Body(category, size, model.place(-middle, 0.0))


@dataclass(frozen=True)
class Saddle:
    """The rider's contact points on a two-wheeler, in the body's frame, metres.

    Attributes:
        hip: position of the pelvis on the saddle; its y is 0.
        hand: position of the left grip; the right one is its mirror image.
        foot: position of the left pedal or peg, under the sole.
        foot_right: position of the right pedal or peg; pedals are half a turn apart.
    """

    hip: tuple[float, float, float]
    hand: tuple[float, float, float]
    foot: tuple[float, float, float]
    foot_right: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class RoadUser:
    """One road user of a drive; its boxes carry ``track_id``."""

    track_id: str
    body: Body
    motion: Motion
