"""Settings of vanilla 3DGS: as released, and as tuned for small budgets."""

from __future__ import annotations

from typing import Final

from splatting.settings import Splatting

RELEASED: Final = Splatting()
TUNED: Final = RELEASED
