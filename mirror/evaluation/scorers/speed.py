"""Measures how fast a method renders."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView

_WARM_UP: Final = 3
MIN_DURATION_S: Final = 5.0
_MAX_VIEWS: Final = 500


def frames_per_second(render: Callable[[RenderView], UInt8], views: Sequence[RenderView]) -> tuple[float, int]:
    """Measure how many images per second a renderer makes, one after the other.

    The first three renders are a warm-up. Then the views are rendered in their order, repeatedly, for at least five
    seconds or until 500 images.

    Args:
        render: the renderer.
        views: the views to render; not empty.

    Returns:
        Images per second, and the number of measured images.

    Raises:
        UsageError: a render does not have the size of its view.
    """
    for number in range(_WARM_UP):
        view = views[number % len(views)]
        image = render(view)
        if image.shape != (view.height_px, view.width_px, 3):
            raise UsageError(
                f"a render of shape {image.shape}", expected=f"{(view.height_px, view.width_px, 3)}", place=view.path
            )
    begin, count, duration_s = time.perf_counter(), 0, 0.0
    while duration_s < MIN_DURATION_S and count < _MAX_VIEWS:
        render(views[count % len(views)])
        count += 1
        duration_s = time.perf_counter() - begin
    return count / duration_s, count
