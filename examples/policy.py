"""A policy in one file: it follows the route, and drives slower where the image of the front camera is dark.

mirror simulate DATASET --scenario free-traffic --policy examples/policy.py:Careful --out rollout
"""

from __future__ import annotations

from hybridworldsim.simulator import Controls, Observation, ObservationSpec


class Careful:
    """See `hybridworldsim.simulator.Policy`."""

    cameras = ("front_wide",)
    privileged = False

    def reset(self, spec: ObservationSpec) -> None:
        """Prepare for a new rollout: nothing is kept from one observation to the next."""

    def act(self, observation: Observation) -> Controls:
        """Return the steer along the arc through a point of the route ahead (pure pursuit), and keep a speed."""
        limit_mps = 6.0 if observation.images["front_wide"].mean() > 80.0 else 3.0
        x_m, y_m = observation.route[4]
        curvature = 2.0 * y_m / max(x_m**2 + y_m**2, 1.0)
        return Controls(2.0 * (limit_mps - observation.ego.speed_mps), curvature)

    def close(self) -> None:
        """Release what the policy holds: nothing."""
