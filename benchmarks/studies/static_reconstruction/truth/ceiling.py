"""What the exact street scores, rendered in the light that the declared policy gives a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.static_reconstruction.declared import NOVEL, TRAINING, Declared
from benchmarks.studies.static_reconstruction.scoring import averaged, scored
from benchmarks.studies.static_reconstruction.truth.asked import Asked, asked
from hybridworldsim.training.appearance import AppearanceSelector, seen_of
from mirror.protocols.views.view import View

POSES: Final = ("recorded", "true")


def ceiling_of(folder: Path, declaration: Declared, scene: str, width_px: int) -> list[dict[str, Any]]:
    """A row a group, light and kind of poses: the exact street in place of a model, scored as one, in all its pictures.

    Held-out pictures in the light of another traversal differ from what was recorded by light, shadows and weather,
    and from the recorded poses, which are all that a method is told, by the errors of these. It is no bound: what
    learns from pictures at erroneous poses may fit them better than the exact street does.
    """
    what = asked(folder, declaration, scene, declaration.split, width_px)
    looks = AppearanceSelector(seen_of(what.views(TRAINING)), declaration.policy, what.plan.views)

    def own(view: View) -> str:
        return view.traversal_id

    def declared(view: View) -> str:
        return looks.of(view).colours[0][0].traversal_id

    wanted: tuple[tuple[str, str, Callable[[View], str]], ...] = (
        (TRAINING, "own", own),
        (NOVEL, "own", own),
        (NOVEL, declaration.policy, declared),
    )
    return [_row(what, group, light, source, poses) for group, light, source in wanted for poses in POSES]


def _row(what: Asked, group: str, light: str, source: Callable[[View], str], poses: str) -> dict[str, Any]:
    pictures, found = what.street.pictures, []
    for view in what.views(group):
        perfect = what.street.lit_as(view, source(view), as_recorded=poses == "recorded")
        found.append(scored(view, perfect, pictures.picture(view), pictures.scored(view)))
    return {"group": group, "light": light, "poses": poses, "pictures": len(found), **averaged(found, group)}
