"""Edits of the light: day rendered as night and back, compared with the same moment in the other light."""

from __future__ import annotations

from typing import Any, Final

from benchmarks.studies.static_reconstruction.declaration import TRAINING
from benchmarks.studies.static_reconstruction.scoring import average_scores, score_image
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel
from hybridworldsim.training.appearance import AppearanceSelector
from hybridworldsim.training.previews import pixels
from mirror.protocols.views.view import RenderView

EDITS: Final = (("day", "night"), ("night", "day"))


def measure_lighting(trained: TrainedModel) -> list[dict[str, Any]]:
    """Return a row for each edit between two lights that the model was trained on."""
    lights = {one.light for one in trained.training_sources}
    return [_edit_row(trained, *edit) for edit in EDITS if lights >= set(edit)]


def target_traversal(trained: TrainedModel, light: str, view: RenderView) -> str:
    """Return the traversal whose appearance a view gets if a light is the policy."""
    selector = AppearanceSelector(trained.training_sources, light, trained.plan.views, everywhere=True)
    return selector.select(view).colours[0][0].traversal_id


def views_in(trained: TrainedModel, light: str) -> list[RenderView]:
    """Return the views of the training traversals that were recorded in a light."""
    known = {one.traversal_id for one in trained.training_sources if one.light == light}
    return [view for view in trained.views(TRAINING) if view.traversal_id in known]


def _edit_row(trained: TrainedModel, before: str, after: str) -> dict[str, Any]:
    plain, relit, street = trained.open(), trained.open(after, everywhere=True), trained.street
    edited, unedited, moved_m, targets = [], [], [], set()
    for view in views_in(trained, before):
        target = target_traversal(trained, after, view)
        targets.add(target)
        shown, kept, mask = relit.render(view), plain.render(view), street.recorded.scored_mask(view)
        true = street.relit(view, target)
        edited.append(score_image(view, pixels(shown.rgb), true, mask))
        unedited.append(score_image(view, pixels(kept.rgb), true, mask))
        moved_m.append(float((shown.depth_m - kept.depth_m).abs().max()))
    own = [score_image(view, plain(view), street.recorded.image(view), street.recorded.scored_mask(view))
           for view in trained.views(TRAINING) if view.traversal_id in targets]  # fmt: skip
    return {
        "edit": f"{before} to {after}",
        "edited": average_scores(edited, TRAINING),
        "unedited": average_scores(unedited, TRAINING),
        "recorded": average_scores(own, TRAINING),
        "moved_m": max(moved_m),
        "pictures": len(edited),
        "targets": sorted(targets),
    }
