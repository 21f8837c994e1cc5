"""Progress of the ego along its route."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog


@dataclass(frozen=True, eq=False)
class Progress:
    """The progress of the ego along its route.

    Attributes:
        progress_m: length along the route at the end, less that at the beginning; negative: it went backwards.
        along_m: (T,) length along the route of the foot of the ego's centre.
        offset_m: (T,) distance of the centre from the route, positive to the left.
        route_ahead_m: length of the route from the beginning of the log on.
    """

    progress_m: float
    along_m: Float64
    offset_m: Float64
    route_ahead_m: float


def route_progress(log: StateLog, route_m: npt.ArrayLike) -> Progress:
    """Project the ego's centre on its route, from stamp to stamp, so that a route may cross itself.

    Args:
        log: states; only the ego is read.
        route_m: (K, 2) points of the route in the frame of the log, in order.

    Raises:
        UsageError: the route has fewer than two points, no length, or a coordinate that is not finite.
    """
    from mirror.metrics.safety.lane_kernels import project_on_line

    route = np.asarray(route_m, np.float64)
    if route.ndim != 2 or route.shape[1:] != (2,) or len(route) < 2 or not np.isfinite(route).all():
        raise UsageError(f"a route of shape {route.shape}", expected="(K, 2) finite coordinates of two points or more")
    route = route - route[0]
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    if lengths[-1] == 0.0:
        raise UsageError("a route of length 0", expected="points at different places")
    centers = np.stack([log.x_m[:, 0], log.y_m[:, 0]], axis=1) - np.asarray(route_m, np.float64)[0]
    along, offset = project_on_line(centers, np.column_stack([route, lengths]))
    return Progress(float(along[-1] - along[0]), along, offset, float(lengths[-1] - along[0]))
