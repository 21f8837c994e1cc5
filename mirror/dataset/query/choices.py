"""Values that a caller chooses: an unknown name is refused with the most similar one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Real

from mirror.errors import UsageError


def require_known(what: str, value: str, known: Iterable[str]) -> None:
    """Refuse a value that is not among the known values.

    Args:
        what: kind of the value, such as ``scene``.
        value: the value.
        known: all values that exist.

    Raises:
        UsageError: the value is unknown.
    """
    values = sorted(set(known))
    if value in values:
        return
    similar = difflib.get_close_matches(str(value), values, n=1, cutoff=0.5)
    listed = ", ".join(values[:20]) + (f" and {len(values) - 20} more" if len(values) > 20 else "")
    raise UsageError(
        f"unknown {what} {value!r}" + (f": did you mean {similar[0]!r}?" if similar else ""),
        expected=f"one of {listed}" if values else f"nothing: the dataset has no {what}",
    )


def parse_interval(time: tuple[int, int] | None) -> tuple[int, int] | None:
    """Return an interval of stamps in nanoseconds as two integers, or None for None.

    Raises:
        UsageError: it is not a pair of whole numbers, or does not begin before its end.
    """
    if time is None:
        return None
    try:
        start, end = time
    except (TypeError, ValueError) as error:
        raise _interval_error(time) from error
    # The remainder of NaN and of infinity is NaN.
    if not all(isinstance(bound, Real) and bound % 1 == 0 for bound in (start, end)) or start >= end:
        raise _interval_error(time)
    return int(start), int(end)


def _interval_error(time: object) -> UsageError:
    return UsageError(f"{time!r}", place="time", expected="(start_ns, end_ns), whole numbers, start before end")
