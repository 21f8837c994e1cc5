"""Whose look an image gets that was not trained on: policies, each by name.

``nearest``: of the training traversal that drove the most similar line. ``mean``: of all. A traversal's id, or a word
of light or weather (``night``, ``rain``): given. ``sweep:A:B``: from one to the other along the trajectory. Of a
traversal's cameras it is the one of the same name; where there is none, the one that looks in the most similar
direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np

from hybridworldsim.training.driven_lines import DrivenLines
from hybridworldsim.training.run.folder import TrainedCamera
from hybridworldsim.training.viewpoint import Source
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView

Blend: TypeAlias = tuple[tuple[Source, float], ...]
"""Looks that were trained on, with weights that sum to one."""

FITTED: Final = "fit"
MEAN: Final = "mean"
SWEEP: Final = "sweep:"
_MOST_PLACES: Final = 48


@dataclass(frozen=True)
class AppearanceChoice:
    """How one image looks.

    Attributes:
        colours: of what.
        content: whose leaves and billboards are there; it stays where the light is edited.
    """

    colours: Blend
    content: Source


def trained_cameras(views: Sequence[RenderView]) -> tuple[TrainedCamera, ...]:
    """The traversals and cameras of training views, with some of the places that they were at."""
    by_source: dict[Source, list[RenderView]] = {}
    for view in views:
        by_source.setdefault(Source(view.traversal_id, view.camera), []).append(view)
    found = []
    for source, own in sorted(by_source.items()):
        chosen = np.unique(np.linspace(0, len(own) - 1, min(len(own), _MOST_PLACES)).round().astype(int))
        places = [own[place].pose for place in chosen]
        found.append(
            TrainedCamera(
                traversal_id=source.traversal_id,
                camera=source.camera,
                light=own[0].light,
                weather=own[0].weather,
                centre_m=tuple(_three(pose.translation[0]) for pose in places),
                forward=tuple(_three(pose.matrix()[0, :3, 2]) for pose in places),
            )
        )
    return tuple(found)


@dataclass(frozen=True)
class AppearanceSelector:
    """The looks of images that shall be rendered.

    Attributes:
        seen: what was trained on, at least one.
        policy: one of the names above; ``fit`` is not among them: it looks at images.
        views: all that will be rendered.
        everywhere: the policy holds for traversals that were trained on too: to edit the light of one.
        lines: of what all blocks of a street were trained on, so that they agree on a look, and of these views; None:
            `seen` is all there is. A block that has not seen what is chosen takes the nearest that it has.
    """

    seen: tuple[TrainedCamera, ...]
    policy: str = "nearest"
    views: Sequence[RenderView] = ()
    everywhere: bool = False
    lines: DrivenLines | None = None

    def __post_init__(self) -> None:
        for word in self._words:
            self._matching(word)

    def select(self, view: RenderView) -> AppearanceChoice:
        """The look of one image.

        Raises:
            UsageError: nothing that was trained on matches the policy.
        """
        own = Source(view.traversal_id, view.camera)
        trained = own in self._by_source
        content = own if trained else self._of_camera(self._traversal(view, None), view)
        if (trained and not self.everywhere) or self.policy in ("nearest", FITTED):
            return AppearanceChoice(((content, 1.0),), content)
        if self.policy == MEAN:
            alike = [source for source in self._by_source if source.camera == content.camera]
            return AppearanceChoice(tuple((source, 1.0 / len(alike)) for source in alike), content)
        ends = [self._of_camera(self._traversal(view, word), view) for word in self._words]
        if len(ends) == 1:
            # A held-out image that is given a look gets all of it; a light that is edited moves nothing.
            return AppearanceChoice(((ends[0], 1.0),), content if self.everywhere else ends[0])
        share = self._share(view)
        return AppearanceChoice(((ends[0], 1.0 - share), (ends[1], share)), content)

    @property
    def _words(self) -> list[str]:
        if self.policy in ("nearest", MEAN, FITTED):
            return []
        if not self.policy.startswith(SWEEP):
            return [self.policy]
        words = self.policy.removeprefix(SWEEP).split(":")
        if len(words) != 2:
            raise UsageError(f"{self.policy!r}", place="--appearance", expected="sweep:FROM:TO")
        return words

    @cached_property
    def _by_source(self) -> dict[Source, TrainedCamera]:
        return {Source(one.traversal_id, one.camera): one for one in self.seen}

    @cached_property
    def _street(self) -> DrivenLines:
        return self.lines or DrivenLines(self.seen, self.views)

    @cached_property
    def _own(self) -> frozenset[str]:
        return frozenset(one.traversal_id for one in self.seen)

    @cached_property
    def _order(self) -> dict[int, float]:
        frames = sorted({view.frame_index for view in self.views})
        return {frame: place / max(len(frames) - 1, 1) for place, frame in enumerate(frames)}

    def _share(self, view: RenderView) -> float:
        if view.frame_index not in self._order:
            raise UsageError("a sweep needs all images that shall be rendered", expected="a trajectory")
        return self._order[view.frame_index]

    def _matching(self, word: str) -> list[str]:
        """Traversals that a word means."""
        known = self._street.known
        found = sorted({one.traversal_id for one in known if word in (one.traversal_id, one.light, one.weather)})
        if not found:
            lights = sorted({word for one in known for word in (one.light, one.weather)})
            traversals = sorted({one.traversal_id for one in known})
            raise UsageError(
                f"nothing that was trained on is {word!r}", place="--appearance",
                expected=f"nearest, mean, fit, sweep:A:B, {', '.join(lights)}, or one of {', '.join(traversals)}",
            )  # fmt: skip
        return found

    def _traversal(self, view: RenderView, word: str | None) -> str:
        """Of the traversals that a word means, or of all, the one whose line is nearest to a view's."""
        names = sorted({one.traversal_id for one in self._street.known}) if word is None else self._matching(word)
        chosen = self._street.nearest(view, names)
        if chosen in self._own:
            return chosen
        return self._street.nearest(view, [name for name in names if name in self._own] or sorted(self._own))

    def _of_camera(self, traversal_id: str, view: RenderView) -> Source:
        wanted = Source(traversal_id, view.camera)
        if wanted in self._by_source:
            return wanted
        here, forward = view.pose.translation[0], view.pose.matrix()[0, :3, 2]
        own = [source for source in self._by_source if source.traversal_id == traversal_id]

        def likeness(source: Source) -> float:
            one = self._by_source[source]
            nearest = np.linalg.norm(np.array(one.centre_m) - here, axis=1).argmin()
            return float(np.array(one.forward[nearest]) @ forward)

        return max(own, key=likeness)


def _three(numbers: Float64) -> tuple[float, float, float]:
    x, y, z = np.round(numbers, 3).tolist()
    return x, y, z
