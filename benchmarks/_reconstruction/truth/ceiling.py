"""What a perfect street would score: the true one, rendered in the light that the declared policy gives a picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from benchmarks._reconstruction.declared import NOVEL, TRAINING
from benchmarks._reconstruction.scoring import averaged, scored
from benchmarks._reconstruction.truth.lighting import target_of
from benchmarks._reconstruction.truth.trained import Trained
from mirror.evaluation.views.view import View

POSES: Final = ("recorded", "true")


def ceiling_of(trained: Trained) -> list[dict[str, Any]]:
    """A row a group, light and kind of poses, all of the views that are looked at.

    Held-out pictures in the light of another traversal differ from what was recorded by light, shadows and weather,
    and from the recorded poses, which are all that a method is told, by the errors of these: no method that takes its
    looks by the policy can be expected to score more than this.
    """

    def own(view: View) -> str:
        return view.traversal_id

    def declared(view: View) -> str:
        return target_of(trained, trained.declaration.policy, view)

    asked: tuple[tuple[str, str, Callable[[View], str]], ...] = (
        (TRAINING, "own", own),
        (NOVEL, "own", own),
        (NOVEL, trained.declaration.policy, declared),
    )
    return [_row(trained, group, light, source, poses) for group, light, source in asked for poses in POSES]


def _row(trained: Trained, group: str, light: str, source: Callable[[View], str], poses: str) -> dict[str, Any]:
    pictures, found = trained.street.pictures, []
    for view in trained.views(group):
        perfect = trained.street.lit_as(view, source(view), as_recorded=poses == "recorded")
        found.append(scored(view, perfect, pictures.picture(view), pictures.scored(view)))
    return {"group": group, "light": light, "poses": poses, "pictures": len(found), **averaged(found, group)}
