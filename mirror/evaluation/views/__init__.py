"""What a submission is asked for: views, their cameras and edits."""

from __future__ import annotations

from mirror.evaluation.views.plan import Plan, plan_views
from mirror.evaluation.views.view import Edit, View

__all__ = ["Edit", "Plan", "View", "plan_views"]
