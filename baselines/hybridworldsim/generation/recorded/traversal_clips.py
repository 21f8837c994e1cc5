"""Makes the clips of one traversal after the other, in this process or in a worker."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybridworldsim.generation.clips.clip import ABSENT, CATEGORIES, Clip
from hybridworldsim.generation.clips.folder import clip_path, read_clip, write_clip
from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.generation.clips.road_map import lines_of_map
from hybridworldsim.generation.recorded.counting import busy_share, count_clip
from hybridworldsim.generation.recorded.documents import ClipCounts, TraversalClips, join_counts
from hybridworldsim.generation.recorded.hidden import HiddenShares
from hybridworldsim.generation.recorded.sources import ClipSources, StaticStreet, list_masked
from hybridworldsim.generation.recorded.window_clip import WindowSource
from hybridworldsim.generation.recorded.windows import TraversalWindows
from hybridworldsim.generation.scenes.backgrounds import Background, open_background
from hybridworldsim.generation.scenes.rig import SceneRig, rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from hybridworldsim.generation.scenes.scene_clip import CLASS_OF
from mirror.dataset.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.dataset.frames import Frame
from mirror.devices import CPU
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model import ModelFolder, ModelRenderer
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_json

_LOOKED_AT = 5
"""Of so many frames, one tells whether a window shows road users: it costs a fraction of making the clip."""


@dataclass(frozen=True)
class ClipSettings:
    """The settings that determine the clips of a traversal.

    Attributes:
        cameras: names.
        size_px: height and width of images.
        frames: frames of a window.
        least_share: a window shows road users where one covers this share of a view,
        least_busy: in this share of its frames.
        min_score: boxes with a lower score are left out.
        method: ``FILE.py:OBJECT`` of the models' method; None: it is installed.
    """

    cameras: tuple[str, ...]
    size_px: tuple[int, int] = (64, 96)
    frames: int = 26
    least_share: float = 0.01
    least_busy: float = 0.3
    min_score: float = 0.3
    method: str | None = None


@dataclass
class ClipMaker:
    """A maker of the clips of traversals, which it writes into a folder.

    Attributes:
        root: folder or address of the dataset.
        poses: layer of poses.
        sources: what the clips are made of.
        settings: see `ClipSettings`.
        out: folder of the clips.
        device: where static models render.
    """

    root: str
    poses: str
    sources: ClipSources
    settings: ClipSettings
    out: Path
    device: str = CPU
    _opened: dict[str, Any] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": {}}

    def make(self, planned: TraversalWindows, advance: Callable[[int], None] = lambda _: None) -> TraversalClips:
        """Make the clips of a traversal that do not exist yet, and the document of the traversal.

        Args:
            planned: its windows.
            advance: called with 1 after each window.

        Raises:
            DatasetError: an image, a mask, a box or the model is missing or broken.
        """
        torch.set_num_threads(1)
        dataset = self._dataset(planned.scene_id)
        frames = dataset.where(traversal=planned.traversal_id).frames()
        clips, parts, quiet = [], [], 0
        unknown: Counter[str] = Counter()
        seen: dict[int, str] = {}
        source = self._source(planned) if planned.firsts else None
        for first in planned.firsts:
            places = range(first, first + planned.stride * self.settings.frames, planned.stride)
            window = [frames[place] for place in places]
            clip = None if source is None else self._clip(source, window)
            advance(1)
            if clip is None:
                quiet += 1
                continue
            clips.append(clip.clip_id)
            parts.append(count_clip(clip))
            seen |= _tracks_of(clip)
            for frame in window:
                unknown.update(name for name in frame.boxes("world").category if name not in CLASS_OF)
        counts = join_counts(parts) if parts else ClipCounts()
        document = TraversalClips(
            traversal=planned.traversal_id,
            rate_hz=planned.rate_hz,
            candidates=planned.candidates,
            standing=planned.standing,
            lacking=planned.left_out,
            quiet=quiet,
            clips=tuple(clips),
            unknown_boxes=dict(sorted(unknown.items())),
            counts=counts.model_copy(update={"tracks": dict(sorted(Counter(seen.values()).items()))}),
        )
        write_json(traversal_file(self.out, planned.traversal_id), document)
        return document

    def _clip(self, source: WindowSource, window: list[Frame]) -> Clip | None:
        """Make or read the clip of a window; None: too few of its frames show a road user."""
        clip_id = f"{window[0].traversal_id}-{window[0].frame_index:05d}"
        if clip_path(self.out, clip_id).is_file():
            return read_clip(self.out, clip_id)
        looked = {place: source.read(window[place]) for place in range(0, len(window), _LOOKED_AT)}
        busy = busy_share(np.stack([one.pixels.tracks for one in looked.values()]), self.settings.least_share)
        if busy < self.settings.least_busy:
            return None
        recorded = [looked.get(place) or source.read(frame) for place, frame in enumerate(window)]
        clip = source.make_clip(clip_id, window, recorded)
        write_clip(self.out, clip)
        return clip

    def _source(self, planned: TraversalWindows) -> WindowSource:
        dataset = self._dataset(planned.scene_id)
        view = dataset.where(traversal=planned.traversal_id)
        row = view.table("traversals", ["light", "weather"]).to_pylist()[0]
        frames = view.frames()
        rig = self._rig(dataset, planned.traversal_id)
        street = self.sources.streets[planned.scene_id]
        views = [
            one
            for first in planned.firsts
            for one in rig.views(frames[first], frames[first].world_SE3_ego, row["light"], row["weather"])
        ]
        background = self._background(dataset, planned, street, views)
        return WindowSource(
            rig,
            background,
            planned.rate_hz,
            row["light"],
            row["weather"],
            {name: number for number, name in enumerate(frames[0].track_ids)},
            self.settings.min_score,
            self._lines(dataset, planned.scene_id),
            self._hidden(dataset, planned.scene_id, background),
        )

    def _background(
        self, dataset: Dataset, planned: TraversalWindows, street: StaticStreet, views: list[RenderView]
    ) -> Background:
        if not street.is_model:
            return open_background(street.text, dataset, "nearest", views)[0]
        if planned.traversal_id in street.trained:
            # Its own appearance, which no other view decides.
            return self._once(f"street {street.text}", lambda: self._open(street, []))
        return self._open(street, views)

    def _open(self, street: StaticStreet, views: list[RenderView]) -> ModelRenderer:
        return ModelFolder.read(Path(street.text), self.settings.method).open(
            AppearancePolicy("nearest", views), device=self.device
        )

    def _hidden(self, dataset: Dataset, scene_id: str, background: Background) -> HiddenShares | None:
        if not isinstance(background, ModelRenderer) or not background.capabilities.renders_depth:
            return None
        names = self.sources.streets[scene_id].trained

        def make() -> HiddenShares:
            masked = list_masked(dataset.where(traversal=list(names)))
            drives = [(dataset.where(traversal=name).frames(), self._rig(dataset, name)) for name in sorted(masked)]
            return HiddenShares(drives, background.render)

        return self._once(f"hidden {scene_id}", make)

    def _lines(self, dataset: Dataset, scene_id: str) -> tuple[MapLine, ...] | None:
        def make() -> tuple[MapLine, ...] | None:
            road_map = dataset.road_map(scene_id)
            if road_map is None:
                return None
            return lines_of_map(road_map, dataset.where(scene=scene_id).frames()[0].track[1].translation)

        return self._once(f"map {scene_id}", make)

    def _rig(self, dataset: Dataset, traversal_id: str) -> SceneRig:
        frames = dataset.where(traversal=traversal_id).frames()
        return rig_of(frames, self.settings.cameras, self.settings.size_px, PIXELS)

    def _dataset(self, scene_id: str) -> Dataset:
        calibrations = self.sources.streets[scene_id].calibrations

        def make() -> Dataset:
            opened = open_dataset(self.root)
            return opened.with_layers(poses=self.poses, boxes=self.sources.boxes, calibrations=calibrations)

        return self._once(f"dataset {calibrations}", make)

    def _once(self, name: str, make: Callable[[], Any]) -> Any:
        if name not in self._opened:
            self._opened[name] = make()
        return self._opened[name]


def traversal_file(out: Path, traversal_id: str) -> Path:
    """Return the file of a traversal's document."""
    return out / "traversals" / f"{traversal_id}.json"


def _tracks_of(clip: Clip) -> dict[int, str]:
    """The classes of the road users that a clip shows, by their numbers."""
    classes = dict(zip(clip.boxes.track.tolist(), clip.boxes.category.tolist()))
    shown = np.unique(clip.tracks if clip.tracks is not None else ABSENT)
    return {track: CATEGORIES[classes[track]] for track in shown[shown != ABSENT].tolist()}
