"""How fast a method renders."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView

_WARM_UP: Final = 3
MIN_DURATION_S: Final = 5.0
_MOST_VIEWS: Final = 500


def frames_per_second(render: Callable[[RenderView], UInt8], views: Sequence[RenderView]) -> tuple[float, int]:
    """How many pictures a second a renderer makes, one after the other, and of how many that is.

    The first three warm it up; then views are rendered for five seconds at least, in their order and from the first
    again.

    Args:
        render: the renderer.
        views: what it is asked for; not empty.

    Raises:
        UsageError: a picture is not of the size that was asked for.
    """
    for place in range(_WARM_UP):
        view = views[place % len(views)]
        picture = render(view)
        if picture.shape != (view.height_px, view.width_px, 3):
            raise UsageError(
                f"a render of shape {picture.shape}", expected=f"{(view.height_px, view.width_px, 3)}", place=view.path
            )
    begin, count, taken = time.perf_counter(), 0, 0.0
    while taken < MIN_DURATION_S and count < _MOST_VIEWS:
        render(views[count % len(views)])
        count += 1
        taken = time.perf_counter() - begin
    return count / taken, count
