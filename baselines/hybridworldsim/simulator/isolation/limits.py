"""The bounds of a policy that runs apart, and where its program finds what it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SOCKET: Final = "/tmp/policy.sock"
"""The socket at which the program serves, in its own file system."""
SOCKET_VARIABLE: Final = "MIRROR_POLICY_SOCKET"
"""Environment variable with the path of the socket."""
DRIVE_VARIABLE: Final = "MIRROR_DRIVE"
"""Environment variable with what the wire does not carry: step and vehicle, as JSON."""


@dataclass(frozen=True)
class PolicyLimits:
    """Bounds of the program of a policy.

    Attributes:
        memory_bytes: greatest memory of all its processes together.
        processes: greatest number of processes and threads.
        disk_bytes: room for files, which is in memory; they are lost with the drive.
        start_s: longest time until it serves.
    """

    memory_bytes: int = 4 << 30
    processes: int = 256
    disk_bytes: int = 256 << 20
    start_s: float = 120.0
