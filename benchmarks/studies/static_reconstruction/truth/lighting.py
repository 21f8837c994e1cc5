"""Light that is edited: day drawn as night and back, against the same moment in the other light."""

from __future__ import annotations

from typing import Any, Final

from benchmarks.studies.static_reconstruction.declared import TRAINING
from benchmarks.studies.static_reconstruction.scoring import averaged, scored
from benchmarks.studies.static_reconstruction.truth.trained import Trained
from hybridworldsim.training.appearance import AppearanceSelector
from hybridworldsim.training.run.specimens import pixels
from mirror.protocols.views.view import View

EDITS: Final = (("day", "night"), ("night", "day"))


def lighting_of(trained: Trained) -> list[dict[str, Any]]:
    """A row an edit that a model can be asked for: it was trained on a traversal of either light."""
    lights = {one.light for one in trained.seen}
    return [_edited(trained, *edit) for edit in EDITS if lights >= set(edit)]


def target_of(trained: Trained, light: str, view: View) -> str:
    """The traversal whose looks a view gets where a light is asked for."""
    looks = AppearanceSelector(trained.seen, light, trained.plan.views, everywhere=True)
    return looks.of(view).colours[0][0].traversal_id


def views_in(trained: Trained, light: str) -> list[View]:
    """Views of traversals that the model was trained on in a light."""
    known = {one.traversal_id for one in trained.seen if one.light == light}
    return [view for view in trained.views(TRAINING) if view.traversal_id in known]


def _edited(trained: Trained, before: str, after: str) -> dict[str, Any]:
    plain, relit, street = trained.open(), trained.open(after, everywhere=True), trained.street
    edited, unedited, moved_m, targets = [], [], [], set()
    for view in views_in(trained, before):
        target = target_of(trained, after, view)
        targets.add(target)
        shown, kept, mask = relit.drawn(view), plain.drawn(view), street.pictures.scored(view)
        true = street.lit_as(view, target)
        edited.append(scored(view, pixels(shown.rgb), true, mask))
        unedited.append(scored(view, pixels(kept.rgb), true, mask))
        moved_m.append(float((shown.depth_m - kept.depth_m).abs().max()))
    own = [scored(view, plain(view), street.pictures.picture(view), street.pictures.scored(view))
           for view in trained.views(TRAINING) if view.traversal_id in targets]  # fmt: skip
    return {
        "edit": f"{before} to {after}",
        "edited": averaged(edited, TRAINING),
        "unedited": averaged(unedited, TRAINING),
        "recorded": averaged(own, TRAINING),
        "moved_m": max(moved_m),
        "pictures": len(edited),
        "targets": sorted(targets),
    }
