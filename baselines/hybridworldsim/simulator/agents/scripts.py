"""Scripts: what an agent of a scenario does, and when it begins; see `mirror.schema.scenario` for the trigger."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mirror.errors import UsageError


@dataclass(frozen=True)
class Script:
    """The manoeuvre of one agent.

    Attributes:
        trigger_ttc_s: time to collision at which it begins.
        latest_s: time at which it begins in any case.
        speed_mps: speed along the agent's way that it aims at; None: the agent keeps its own.
        acceleration_mps2: greatest change of speed on the way to that speed.
        shift_m: change of the offset to the left of its way.
        shift_s: duration of that change.
        stay_s: time after which the agent shifts back; None: it stays.
        stands: whether the agent counts as standing for the trigger.
        is_line: whether the gap is that to the agent's way, not to its body.
        moves_before: whether the agent drives by its own rules before the script begins; otherwise it keeps its speed.
        follows_after: whether the agent drives by its own rules once the manoeuvre has ended.
    """

    trigger_ttc_s: float
    latest_s: float = math.inf
    speed_mps: float | None = None
    acceleration_mps2: float = 3.0
    shift_m: float = 0.0
    shift_s: float = 2.0
    stay_s: float | None = None
    stands: bool = False
    is_line: bool = False
    moves_before: bool = False
    follows_after: bool = False

    def __post_init__(self) -> None:
        for name in ("trigger_ttc_s", "acceleration_mps2", "shift_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{name} is {value}", place="script", expected="a positive number")

    def order(self, speed_mps: float, own_speed_mps: float) -> float:
        """Return the acceleration towards the target speed.

        Args:
            speed_mps: present speed.
            own_speed_mps: speed at the beginning of the script.
        """
        target = own_speed_mps if self.speed_mps is None else self.speed_mps
        wanted = 4.0 * (target - speed_mps)
        return min(max(wanted, -self.acceleration_mps2), self.acceleration_mps2)

    def shift(self, since_s: float) -> tuple[float, float]:
        """Return the offset and its rate at a time since the script's beginning."""
        offset, rate = _quintic_step(since_s / self.shift_s)
        if self.stay_s is not None:
            back, rate_back = _quintic_step((since_s - self.shift_s - self.stay_s) / self.shift_s)
            offset, rate = offset - back, rate - rate_back
        return self.shift_m * offset, self.shift_m * rate / self.shift_s

    def has_ended(self, since_s: float, speed_mps: float, own_speed_mps: float) -> bool:
        """Return whether the agent has its final offset and speed."""
        target = own_speed_mps if self.speed_mps is None else self.speed_mps
        shifts_s = 0.0 if not self.shift_m else self.shift_s
        if self.stay_s is not None:
            shifts_s = 2.0 * self.shift_s + self.stay_s
        return since_s >= shifts_s and abs(speed_mps - target) < 0.1


def _quintic_step(share: float) -> tuple[float, float]:
    """Value and slope of a step from 0 to 1 whose first two derivatives are 0 at both ends."""
    inside = min(max(share, 0.0), 1.0)
    value = inside**3 * (10.0 - 15.0 * inside + 6.0 * inside**2)
    return value, 30.0 * inside**2 * (1.0 - inside) ** 2
