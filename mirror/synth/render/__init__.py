"""The renderer: planar faces and ellipsoids through any lens, by tiles, with shadows, lamps, weather and exact truth.

`render` makes any view of a world. Importing it takes numba with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mirror.synth.render.rendering import render as render

__all__ = ["render"]


def __getattr__(name: str) -> object:
    if name == "render":
        from mirror.synth.render.rendering import render

        return render
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
