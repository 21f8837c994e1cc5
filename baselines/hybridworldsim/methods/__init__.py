"""Methods of static reconstruction that the entry points ``mirror.methods`` name."""

from __future__ import annotations

import os

# By default, waiting OpenMP threads spin and take processor time from working ones.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
