"""Policies that choose the appearance of images of untrained traversals and cameras.

``nearest``: of the training traversal that drove the most similar line. ``mean``: of all training traversals. The id of
a traversal, or a word of light or weather (``night``, ``rain``): of that traversal. ``sweep:A:B``: from one to the
other along the trajectory. The camera is the traversal's camera of the same name, or else the one with the most similar
direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np

from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.documents import TrainedCamera
from hybridworldsim.training.driven_lines import DrivenLines
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView

Blend: TypeAlias = tuple[tuple[Source, float], ...]
"""Trained appearances with weights that sum to one."""

FITTED: Final = "fit"
MEAN: Final = "mean"
SWEEP: Final = "sweep:"
_MOST_PLACES: Final = 48


@dataclass(frozen=True)
class AppearanceChoice:
    """The appearance of one image.

    Attributes:
        colours: mixture of appearances for the colours.
        content: appearance of the content (leaves, billboards); it stays the same when the light is edited.
    """

    colours: Blend
    content: Source


def trained_cameras(views: Sequence[RenderView]) -> tuple[TrainedCamera, ...]:
    """Return the traversals and cameras of training views, each with a sample of poses."""
    by_source: dict[Source, list[RenderView]] = {}
    for view in views:
        by_source.setdefault(Source(view.traversal_id, view.camera), []).append(view)
    cameras = []
    for source, own_views in sorted(by_source.items()):
        chosen = np.unique(np.linspace(0, len(own_views) - 1, min(len(own_views), _MOST_PLACES)).round().astype(int))
        places = [own_views[place].pose for place in chosen]
        cameras.append(
            TrainedCamera(
                traversal_id=source.traversal_id,
                camera=source.camera,
                light=own_views[0].light,
                weather=own_views[0].weather,
                centre_m=tuple(_rounded_triple(pose.translation[0]) for pose in places),
                forward=tuple(_rounded_triple(pose.matrix()[0, :3, 2]) for pose in places),
            )
        )
    return tuple(cameras)


@dataclass(frozen=True)
class AppearanceSelector:
    """A selector of the appearances of the images to render.

    Attributes:
        trained: trained traversals and cameras, at least one.
        policy: one of the names above, except ``fit``, which reads images.
        views: all views to render.
        everywhere: apply the policy to trained traversals too, to edit their light.
        lines: lines of all blocks of a street and of these views, so that the blocks select the same appearance; None:
            lines of `trained` only. A block that was not trained on the selected traversal takes its nearest one.
    """

    trained: tuple[TrainedCamera, ...]
    policy: str = "nearest"
    views: Sequence[RenderView] = ()
    everywhere: bool = False
    lines: DrivenLines | None = None

    def __post_init__(self) -> None:
        for word in self._words:
            self._matching(word)

    def select(self, view: RenderView) -> AppearanceChoice:
        """Select the appearance of one view.

        Raises:
            UsageError: no trained traversal matches the policy.
        """
        source = Source(view.traversal_id, view.camera)
        is_trained = source in self._by_source
        content = source if is_trained else self._of_camera(self._traversal(view, None), view)
        if (is_trained and not self.everywhere) or self.policy in ("nearest", FITTED):
            return AppearanceChoice(((content, 1.0),), content)
        if self.policy == MEAN:
            same_camera = [source for source in self._by_source if source.camera == content.camera]
            return AppearanceChoice(tuple((source, 1.0 / len(same_camera)) for source in same_camera), content)
        mixed = [self._of_camera(self._traversal(view, word), view) for word in self._words]
        if len(mixed) == 1:
            # A held-out image also gets the content of the named traversal; editing the light keeps the content.
            return AppearanceChoice(((mixed[0], 1.0),), content if self.everywhere else mixed[0])
        share = self._share(view)
        return AppearanceChoice(((mixed[0], 1.0 - share), (mixed[1], share)), content)

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
        return {Source(camera.traversal_id, camera.camera): camera for camera in self.trained}

    @cached_property
    def _street(self) -> DrivenLines:
        return self.lines or DrivenLines(self.trained, self.views)

    @cached_property
    def _own(self) -> frozenset[str]:
        return frozenset(camera.traversal_id for camera in self.trained)

    @cached_property
    def _order(self) -> dict[int, float]:
        frames = sorted({view.frame_index for view in self.views})
        return {frame: place / max(len(frames) - 1, 1) for place, frame in enumerate(frames)}

    def _share(self, view: RenderView) -> float:
        if view.frame_index not in self._order:
            raise UsageError("a sweep needs all views to be rendered", expected="a trajectory")
        return self._order[view.frame_index]

    def _matching(self, word: str) -> list[str]:
        """Trained traversals that a word names."""
        known = self._street.known
        names = sorted(
            {camera.traversal_id for camera in known if word in (camera.traversal_id, camera.light, camera.weather)}
        )
        if not names:
            lights = sorted({word for camera in known for word in (camera.light, camera.weather)})
            traversals = sorted({camera.traversal_id for camera in known})
            raise UsageError(
                f"no trained traversal is {word!r}", place="--appearance",
                expected=f"nearest, mean, fit, sweep:A:B, {', '.join(lights)}, or one of {', '.join(traversals)}",
            )  # fmt: skip
        return names

    def _traversal(self, view: RenderView, word: str | None) -> str:
        """The traversal with the line nearest to a view's, among those that a word names or among all."""
        names = sorted({camera.traversal_id for camera in self._street.known}) if word is None else self._matching(word)
        chosen = self._street.nearest(view, names)
        if chosen in self._own:
            return chosen
        return self._street.nearest(view, [name for name in names if name in self._own] or sorted(self._own))

    def _of_camera(self, traversal_id: str, view: RenderView) -> Source:
        source = Source(traversal_id, view.camera)
        if source in self._by_source:
            return source
        camera_m, forward = view.pose.translation[0], view.pose.matrix()[0, :3, 2]
        sources = [source for source in self._by_source if source.traversal_id == traversal_id]

        def alignment(source: Source) -> float:
            camera = self._by_source[source]
            nearest = np.linalg.norm(np.array(camera.centre_m) - camera_m, axis=1).argmin()
            return float(np.array(camera.forward[nearest]) @ forward)

        return max(sources, key=alignment)


def _rounded_triple(numbers: Float64) -> tuple[float, float, float]:
    x, y, z = np.round(numbers, 3).tolist()
    return x, y, z
