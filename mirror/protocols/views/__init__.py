"""The views that a protocol requests from a submission, with their cameras and edits."""

from __future__ import annotations

from mirror.protocols.views.plan import Plan, plan_views
from mirror.protocols.views.view import Edit, RenderView

__all__ = ["Edit", "Plan", "RenderView", "plan_views"]
