"""Light and weather of a drive: the condition, where the sun stands, the sky, and what the renderer makes of them."""

from __future__ import annotations
