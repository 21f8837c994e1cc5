"""What agents of a scenario do: the behaviours with their parameters, and the trigger of the scripted ones.

A scripted agent acts when its trigger fires: once the ego's time to collision with the agent falls to
``trigger.ttc_s``. This time to collision is measured along the ego's route,

    ttc = gap / (ego speed - agent speed),

with the gap between the two bodies and the agent's signed speed along the route. Some manoeuvres change that speed, so
for ``hard-brake`` and ``pull-out`` the agent counts as standing, and for ``crossing-pedestrian`` the gap is the ego's
distance to the line on which the pedestrian walks. It is infinite while the gap does not shrink.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mirror.schema.documents import Document

Side = Literal["left", "right"]


class Trigger(Document):
    """The condition at which a scripted agent acts.

    Attributes:
        ttc_s: the agent acts once the ego's time to collision with it is at most this.
        latest_s: it acts at this time at the latest, counted from the start; None: only the time to collision counts.
    """

    ttc_s: float = Field(gt=0, le=60)
    latest_s: float | None = Field(default=None, ge=0, allow_inf_nan=False)


class Replay(Document):
    """Recorded road users repeat their recorded motion, whatever the ego does.

    Attributes:
        kind: always ``replay``.
        tracks: track ids; None: all tracks of the recording that the ego starts from.
    """

    kind: Literal["replay"]
    tracks: tuple[str, ...] | None = None


class Idm(Document):
    """Vehicles follow lanes with the intelligent driver model and react to the ego (Treiber et al., 2000).

    Attributes:
        kind: always ``idm``.
        desired_share: desired speed as a share of the lane's speed limit.
        headway_s: desired time gap to the vehicle ahead.
        max_acceleration_mps2: greatest acceleration.
        comfortable_deceleration_mps2: comfortable deceleration.
        radius_m: vehicles start within this distance of the ego.
        ahead_m: gap from the ego's front to the agent's rear at the start, on the ego's route; None: a place on the
            lanes within ``radius_m``, drawn from the seed.
        speed_mps: speed at the start; None: the speed at which the agent would drive there.
    """

    kind: Literal["idm"]
    desired_share: float = Field(default=1.0, gt=0, le=2)
    headway_s: float = Field(default=1.5, gt=0, le=10)
    max_acceleration_mps2: float = Field(default=1.5, gt=0, le=10)
    comfortable_deceleration_mps2: float = Field(default=2.0, gt=0, le=10)
    radius_m: float = Field(default=120.0, gt=0, le=1000)
    ahead_m: float | None = Field(default=None, gt=0, le=1000)
    speed_mps: float | None = Field(default=None, ge=0, le=60)


class CutIn(Document):
    """A vehicle of a neighbouring lane changes to the ego's lane in front of the ego.

    Where the map has no such lane, the vehicle drives beside the ego's lane at ``offset_m``.

    Attributes:
        kind: always ``cut-in``.
        trigger: when the lane change begins.
        side: the side from which it comes.
        ahead_m: gap from the ego's front to the agent's rear at the start.
        speed_mps: its speed.
        offset_m: distance between the middles of the two lanes, where the map has no neighbouring lane.
        change_s: duration of the lane change.
    """

    kind: Literal["cut-in"]
    trigger: Trigger
    side: Side = "left"
    ahead_m: float = Field(default=25.0, ge=0, le=500)
    speed_mps: float = Field(default=8.0, ge=0, le=60)
    offset_m: float = Field(default=3.5, gt=0, le=10)
    change_s: float = Field(default=3.0, gt=0, le=20)


class HardBrake(Document):
    """The vehicle ahead of the ego brakes to a stop. For the trigger it counts as standing.

    Attributes:
        kind: always ``hard-brake``.
        trigger: when it brakes.
        ahead_m: gap from the ego's front to the agent's rear at the start.
        speed_mps: its speed before.
        deceleration_mps2: its deceleration.
    """

    kind: Literal["hard-brake"]
    trigger: Trigger
    ahead_m: float = Field(default=25.0, gt=0, le=500)
    speed_mps: float = Field(default=10.0, ge=0, le=60)
    deceleration_mps2: float = Field(default=6.0, gt=0, le=12)


class CrossingPedestrian(Document):
    """A pedestrian walks across the ego's lane, straight and without regard to traffic.

    Attributes:
        kind: always ``crossing-pedestrian``.
        trigger: when the pedestrian starts to walk: the ego's time to the pedestrian's line.
        side: the side from which the pedestrian comes.
        ahead_m: distance from the ego's front to the pedestrian's line at the start.
        offset_m: the pedestrian's distance from the middle of the ego's lane at the start.
        speed_mps: walking speed.
    """

    kind: Literal["crossing-pedestrian"]
    trigger: Trigger
    side: Side = "right"
    ahead_m: float = Field(default=45.0, gt=0, le=500)
    offset_m: float = Field(default=5.0, gt=0, le=30)
    speed_mps: float = Field(default=1.5, gt=0, le=6)


class OncomingOvertake(Document):
    """An oncoming vehicle moves to the ego's lane to overtake, and returns to its own lane after a while.

    Attributes:
        kind: always ``oncoming-overtake``.
        trigger: when it leaves its lane. Both move, so the gap shrinks with the sum of their speeds.
        ahead_m: gap between the fronts at the start.
        speed_mps: its speed.
        offset_m: distance between the middles of the two lanes, where the map has no oncoming lane.
        change_s: duration of each lane change.
        stay_s: time that it drives in the ego's lane.
    """

    kind: Literal["oncoming-overtake"]
    trigger: Trigger
    ahead_m: float = Field(default=120.0, gt=0, le=1000)
    speed_mps: float = Field(default=12.0, gt=0, le=60)
    offset_m: float = Field(default=3.5, gt=0, le=10)
    change_s: float = Field(default=2.0, gt=0, le=20)
    stay_s: float = Field(default=1.0, ge=0, le=60)


class PullOut(Document):
    """A vehicle that is parked beside the ego's lane drives out into it. For the trigger it counts as standing.

    Attributes:
        kind: always ``pull-out``.
        trigger: when it starts.
        side: the side on which it is parked.
        ahead_m: gap from the ego's front to the agent's rear at the start.
        offset_m: distance of its middle from the middle of the ego's lane.
        acceleration_mps2: its acceleration.
        speed_mps: the speed that it accelerates to.
        change_s: duration of the lane change.
    """

    kind: Literal["pull-out"]
    trigger: Trigger
    side: Side = "right"
    ahead_m: float = Field(default=50.0, gt=0, le=500)
    offset_m: float = Field(default=3.0, gt=0, le=10)
    acceleration_mps2: float = Field(default=1.5, gt=0, le=10)
    speed_mps: float = Field(default=6.0, gt=0, le=60)
    change_s: float = Field(default=2.5, gt=0, le=20)


class StoppedQueue(Document):
    """Vehicles stand one behind another in the ego's lane. The agent's ``count`` is their number.

    Attributes:
        kind: always ``stopped-queue``.
        ttc_s: time to collision of the ego with the last vehicle at the start; it sets the place of the queue.
        spacing_m: gap between the vehicles.
    """

    kind: Literal["stopped-queue"]
    ttc_s: float = Field(default=6.0, gt=0, le=60)
    spacing_m: float = Field(default=2.0, gt=0, le=50)


class Attack(Document):
    """A vehicle takes the plausible trajectory with the least time to collision, found by a search.

    Attributes:
        kind: always ``attack``.
        trigger: when it leaves its lane.
        ahead_m: gap from the ego's front to the agent's rear at the start.
        side: the side of the ego's lane on which it starts.
        offset_m: its distance from the middle of the ego's lane at the start.
        speed_mps: its speed at the start.
        evaluations: number of trajectories that the search may try.
        horizon_s: duration of a trajectory.
        max_acceleration_mps2: greatest longitudinal acceleration and deceleration of a plausible trajectory.
        max_lateral_acceleration_mps2: its greatest lateral acceleration.
    """

    kind: Literal["attack"]
    trigger: Trigger
    ahead_m: float = Field(default=20.0, ge=0, le=500)
    side: Side = "left"
    offset_m: float = Field(default=3.5, gt=0, le=10)
    speed_mps: float = Field(default=8.0, ge=0, le=60)
    evaluations: int = Field(default=50, ge=1, le=50)
    horizon_s: float = Field(default=4.0, gt=0, le=20)
    max_acceleration_mps2: float = Field(default=4.0, gt=0, le=12)
    max_lateral_acceleration_mps2: float = Field(default=4.0, gt=0, le=12)


Behaviour = Annotated[
    Replay | Idm | CutIn | HardBrake | CrossingPedestrian | OncomingOvertake | PullOut | StoppedQueue | Attack,
    Field(discriminator="kind"),
]
