"""Times as pages and the console show them: UTC, and beside it the local mean solar time.

Words of light (day, dusk, night) follow the sun of the place. Beside an hour in UTC alone they look wrong: a drive in
Guangzhou at 01:31 UTC is one of the morning.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

_SECONDS_PER_DEGREE: Final = 240.0


def utc(stamp_ns: int) -> str:
    """Format a timestamp in UTC, such as ``2025-05-14 01:31:20``."""
    return datetime.fromtimestamp(stamp_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def solar_time(stamp_ns: int, longitude_deg: float | None) -> str:
    """Format the local mean solar time, such as ``09:05``; empty without a longitude.

    Args:
        stamp_ns: Unix time.
        longitude_deg: WGS 84; None in a local metric frame.
    """
    return "" if longitude_deg is None else _solar(stamp_ns, longitude_deg).strftime("%H:%M")


def solar_date(stamp_ns: int, longitude_deg: float | None) -> str:
    """Format the date at the place by the local mean solar time, such as ``2025-05-14``; in UTC without a longitude.

    Args:
        stamp_ns: Unix time.
        longitude_deg: WGS 84; None in a local metric frame.
    """
    return _solar(stamp_ns, longitude_deg or 0.0).strftime("%Y-%m-%d")


def _solar(stamp_ns: int, longitude_deg: float) -> datetime:
    return datetime.fromtimestamp(stamp_ns // 10**9 + round(_SECONDS_PER_DEGREE * longitude_deg), UTC)


def utc_and_solar(stamp_ns: int, longitude_deg: float | None) -> str:
    """Format a timestamp in UTC, with the solar time in brackets where the place is known."""
    local = solar_time(stamp_ns, longitude_deg)
    return f"{utc(stamp_ns)} UTC" + (f" ({local} solar time)" if local else "")


def longitude_of(row: Mapping[str, Any]) -> float | None:
    """Return the longitude of a traversal's row, from its bounding box in degrees; None in a local metric frame."""
    bbox = row.get("bbox")
    return None if bbox is None else bbox["xmin"]
