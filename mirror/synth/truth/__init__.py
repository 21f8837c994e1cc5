"""Exact ground truth of a recording: depth, normals, masks, flow, boxes with visibility, poses, calibrations."""

from __future__ import annotations

from mirror.synth.truth.files import Truth
from mirror.synth.truth.flow import static_flow

__all__ = ["Truth", "static_flow"]
