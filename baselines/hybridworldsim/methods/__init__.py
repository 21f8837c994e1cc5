"""Methods of static reconstruction as the entry points ``mirror.methods`` name them."""

from __future__ import annotations

import os

# Threads of OpenMP that wait spin by default, and take the time of those that work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
