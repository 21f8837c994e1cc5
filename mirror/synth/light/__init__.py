"""Light and weather of a drive: the condition, the position of the sun, the sky, and the renderer's lighting record."""

from __future__ import annotations
