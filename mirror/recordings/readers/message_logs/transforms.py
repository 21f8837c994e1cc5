"""Frames of a log and the transforms between them: fixed mountings, and a moving vehicle."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses

# A mounting is fixed if its transform stays within this of the first one.
_FIXED_M: Final = 1e-3
_FIXED_RAD: Final = 1e-4


@dataclass
class Transforms:
    """Transforms ``parent_SE3_child`` by edge, with their stamps.

    Args:
        file: the log, for messages.
    """

    file: Path
    _stamps: dict[tuple[str, str], list[int]] = field(default_factory=lambda: defaultdict(list))
    _values: dict[tuple[str, str], list[Sequence[float]]] = field(default_factory=lambda: defaultdict(list))

    def add(self, parent: str, child: str, stamp_ns: int, pose: Sequence[float]) -> None:
        """Add one transform, given as a quaternion (scalar first) and a translation."""
        edge = (parent.lstrip("/"), child.lstrip("/"))
        self._stamps[edge].append(stamp_ns)
        self._values[edge].append(pose)

    def frames(self) -> set[str]:
        """Return the names of all frames."""
        return {name for edge in self._stamps for name in edge}

    def mounting(self, ego: str, frame: str) -> Poses | None:
        """Return ``ego_SE3_frame`` of a frame that is fixed to the vehicle; None if no transforms lead there.

        Raises:
            RecordingError: a transform of the chain is invalid, or changes over time.
        """
        chain = self._chain(ego.lstrip("/"), frame.lstrip("/"))
        if chain is None:
            return None
        pose = Poses.identity()
        for edge, forward in chain:
            values = self._poses(edge)
            first = values[np.zeros(1, np.int64)]
            moved = first.inverse() @ values
            turned = 2.0 * np.arctan2(np.linalg.norm(moved.rotation[:, 1:], axis=1), moved.rotation[:, 0])
            if np.linalg.norm(moved.translation, axis=1).max() > _FIXED_M or turned.max() > _FIXED_RAD:
                raise RecordingError(
                    f"the transform from {edge[0]} to {edge[1]} changes over time",
                    file=self.file,
                    place=f"mounting of {frame} on {ego}",
                    expected="a fixed mounting",
                    remedy="name the right ego_frame in the topics file",
                )
            pose = pose @ (first if forward else first.inverse())
        return pose

    def motion(self, fixed: str, ego: str) -> tuple[Int64, Poses]:
        """Return poses ``fixed_SE3_ego`` at the stamps of the most frequent transform on the chain between both frames.

        Returns:
            (N,) stamps in ascending order, repeated ones included, and N poses. Stamps outside the range of another
            moving transform are left out.

        Raises:
            RecordingError: no chain of transforms leads from one frame to the other, or the chain does not move.
        """
        chain = self._chain(fixed.lstrip("/"), ego.lstrip("/"))
        if not chain:
            raise RecordingError(
                f"no chain of transforms leads from {fixed!r} to {ego!r}",
                file=self.file,
                place="pose.transform",
                expected=f"two different frames among {', '.join(sorted(self.frames())) or 'none'}",
                remedy="correct the topics file",
            )
        sampled = {edge: self._in_order(edge) for edge, _ in chain}
        main = max(sampled, key=lambda edge: len(sampled[edge][0]))
        stamps = np.sort(np.array(self._stamps[main], np.int64))
        if len(sampled[main][0]) < 2:
            raise RecordingError(
                f"the vehicle does not move: {' to '.join(main)} has {len(stamps)} stamp",
                file=self.file,
                place="pose.transform",
                expected="transforms over time",
                remedy="name the moving frames in the topics file",
            )
        for times, _ in sampled.values():
            if len(times) > 1:
                stamps = stamps[(stamps >= times[0]) & (stamps <= times[-1])]
        pose = Poses.identity(len(stamps))
        for edge, forward in chain:
            times, values = sampled[edge]
            here = interpolate(times, values, stamps) if len(times) > 1 else values[np.zeros(len(stamps), np.int64)]
            pose = pose @ (here if forward else here.inverse())
        return stamps, pose

    def _chain(self, start: str, end: str) -> list[tuple[tuple[str, str], bool]] | None:
        """The edges from a frame to another, each with whether it is passed from parent to child; breadth first."""
        reached: dict[str, list[tuple[tuple[str, str], bool]]] = {start: []}
        waiting = [start]
        for frame in waiting:
            for edge in self._stamps:
                for here, there, forward in ((edge[0], edge[1], True), (edge[1], edge[0], False)):
                    if here == frame and there not in reached:
                        reached[there] = [*reached[frame], (edge, forward)]
                        waiting.append(there)
        return reached.get(end)

    def _in_order(self, edge: tuple[str, str]) -> tuple[Int64, Poses]:
        """Stamps and poses of one edge, sorted by time; of repeated stamps the first is kept."""
        stamps, first = np.unique(np.array(self._stamps[edge], np.int64), return_index=True)
        return stamps, self._poses(edge)[first]

    def _poses(self, edge: tuple[str, str]) -> Poses:
        values: Float64 = np.array(self._values[edge], np.float64)
        norm = np.linalg.norm(values[:, :4], axis=1)
        bad = ~(np.isfinite(values).all(axis=1) & (np.abs(norm - 1.0) < 1e-2))
        if bad.any():
            row = int(np.argmax(bad))
            raise RecordingError(
                f"the transform from {edge[0]} to {edge[1]} is {values[row].tolist()}",
                file=self.file,
                place=f"stamp {self._stamps[edge][row]}",
                expected="a unit quaternion and a finite translation",
                remedy="correct the log",
            )
        return Poses(values[:, :4], values[:, 4:])
