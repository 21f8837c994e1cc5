"""Who moves in the street, and how: lines along lanes, traffic that is simulated ahead of time, signals.

The former driving is still found here until the new street takes its place.
"""

from __future__ import annotations

from mirror.synth.driving.former import Drive, Following, Stop

__all__ = ["Drive", "Following", "Stop"]
