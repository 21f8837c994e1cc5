"""Scores of the exact street, rendered in place of a model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.static_reconstruction.declaration import NOVEL, TRAINING, Declaration
from benchmarks.studies.static_reconstruction.scoring import average_scores, score_image
from benchmarks.studies.static_reconstruction.truth.request import TruthRequest, request_truth
from hybridworldsim.training.appearance import AppearanceSelector, trained_cameras
from mirror.protocols.views.view import RenderView

POSES: Final = ("recorded", "true")


def score_exact_street(folder: Path, declaration: Declaration, scene: str, width_px: int) -> list[dict[str, Any]]:
    """Score renders of the exact street as those of a model, over all images of a scene.

    Held-out images in the light of another traversal differ from the recorded ones by light, shadows and weather.
    Renders from the recorded poses, which are all that a method knows, differ by the errors of these poses too. The
    scores are no upper bound: a model that learns from images with pose errors can fit them better than this.

    Returns:
        A row for each group of views, light and kind of poses.
    """
    request = request_truth(folder, declaration, scene, declaration.split, width_px)
    selector = AppearanceSelector(trained_cameras(request.views(TRAINING)), declaration.policy, request.plan.views)

    def of_its_own(view: RenderView) -> str:
        return view.traversal_id

    def of_policy(view: RenderView) -> str:
        return selector.select(view).colours[0][0].traversal_id

    rows: tuple[tuple[str, str, Callable[[RenderView], str]], ...] = (
        (TRAINING, "own", of_its_own),
        (NOVEL, "own", of_its_own),
        (NOVEL, declaration.policy, of_policy),
    )
    return [_row(request, group, light, source, poses) for group, light, source in rows for poses in POSES]


def _row(
    request: TruthRequest, group: str, light: str, source: Callable[[RenderView], str], poses: str
) -> dict[str, Any]:
    recorded, found = request.street.recorded, []
    for view in request.views(group):
        render = request.street.relit(view, source(view), as_recorded=poses == "recorded")
        found.append(score_image(view, render, recorded.image(view), recorded.scored_mask(view)))
    return {"group": group, "light": light, "poses": poses, "pictures": len(found), **average_scores(found, group)}
