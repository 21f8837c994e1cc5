"""The appearance policy: which appearance the renders of untrained traversals and cameras get."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

_CHOOSING: Final = ("nearest", "mean", "fit")
_SWEEP: Final = "sweep:"


@dataclass(frozen=True)
class AppearancePolicy:
    """The policy that chooses an appearance for renders of traversals and cameras that a method was not trained on.

    Attributes:
        policy: ``nearest``, ``mean``, ``fit``, a traversal, a word of light or weather, or ``sweep:A:B``.
        views: all views that will be rendered, so that a policy can compare complete driven lines.
        everywhere: whether the policy also applies to trained traversals, which edits their light.
        headlights: whether the vehicle's headlights are on in appearances that were recorded with them; False needs a
            method with the capability `has_headlights`.
        truth: only for ``fit``: the dataset and plan that give the images; only the protocol's fitted part is read.
    """

    policy: str = "nearest"
    views: Sequence[RenderView] = ()
    everywhere: bool = False
    headlights: bool = True
    truth: tuple[Dataset, Plan] | None = None


def require_known_appearance(policy: str, dataset: Dataset, trained: Collection[str]) -> None:
    """Require that the words of an appearance policy name traversals of a training, or their light or weather.

    Args:
        policy: as in `AppearancePolicy`.
        dataset: the dataset of the training.
        trained: ids of the traversals that the model was trained on.

    Raises:
        UsageError: a word names none of them.
    """
    if policy in _CHOOSING:
        return
    words = policy.removeprefix(_SWEEP).split(":") if policy.startswith(_SWEEP) else [policy]
    columns = ["traversal_id", "light", "weather"]
    rows = dataset.where(traversal=sorted(trained)).table("traversals", columns).to_pylist()
    known = [sorted({str(row[column]) for row in rows if row[column] is not None}) for column in columns]
    traversals, lights, weathers = known
    unknown = [word for word in words if word not in (*traversals, *lights, *weathers)]
    if unknown:
        raise UsageError(
            f"no trained traversal is {unknown[0]!r}", place="--appearance",
            expected=f"{', '.join(_CHOOSING)}, sweep:A:B, {', '.join((*lights, *weathers))},"
            f" or one of {', '.join(traversals)}",
        )  # fmt: skip
