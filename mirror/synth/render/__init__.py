"""The renderer: faces and ellipsoids seen through any lens, with shadows, lamps and wet roads.

It is imported by those who draw: it takes numba with it.
"""

from __future__ import annotations
