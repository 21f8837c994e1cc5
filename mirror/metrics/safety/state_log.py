"""State log of a drive: where every actor is at every stamp, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.schema.road_features import SIGNAL_STATES


@dataclass(frozen=True, eq=False)
class StateLog:
    """States of the ego vehicle (actor 0) and N - 1 agents at T stamps, in one metric frame seen from above.

    Between two stamps, centres, velocities and headings are linear in time; headings take the shorter way round.

    Args:
        stamps_ns: (T,) int64, strictly increasing.
        x_m: (T, N) x of the boxes' centres.
        y_m: (T, N) y of the boxes' centres.
        yaw_rad: (T, N) headings: angles from x towards y.
        vx_mps: (T, N) velocity of the centres along x.
        vy_mps: (T, N) velocity of the centres along y.
        length_m: (N,) box lengths, along the heading.
        width_m: (N,) box widths.
        present: (T, N) whether an actor exists at a stamp. The values of absent actors are not read.
        ids: N distinct names.
        categories: N categories, such as ``car`` and ``pedestrian``.
        rear_axle_to_center_m: distance from the ego's rear axle forward to the centre of its box.
        signals: ids of S signals of the map.
        signal_states: (T, S) their states: indices into `mirror.schema.road_map.SIGNAL_STATES`; None: there are none.

    Raises:
        UsageError: shapes do not agree, stamps do not increase, the ego is absent at a stamp, a size is not positive,
            the state of a present actor is not finite, or a signal's state is unknown; the actor and the stamp are
            named.
    """

    stamps_ns: Int64
    x_m: Float64
    y_m: Float64
    yaw_rad: Float64
    vx_mps: Float64
    vy_mps: Float64
    length_m: Float64
    width_m: Float64
    present: Bool
    ids: tuple[str, ...]
    categories: tuple[str, ...]
    rear_axle_to_center_m: float
    signals: tuple[str, ...] = ()
    signal_states: npt.NDArray[np.int8] | None = None

    def __post_init__(self) -> None:
        stamps, actors = self._shape()
        for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps"):
            values = self._array(name, np.float64, (stamps, actors))
            bad = np.argwhere(self._array("present", np.bool_, (stamps, actors)) & ~np.isfinite(values))
            if len(bad):
                row, column = bad[0]
                raise UsageError(
                    f"{name} is {values[row, column]}",
                    place=f"actor {self.ids[column]!r}, stamp {self.stamps_ns[row]}",
                    expected="a finite number",
                )
        for name in ("length_m", "width_m"):
            sizes = self._array(name, np.float64, (actors,))
            wrong = np.flatnonzero(~(np.isfinite(sizes) & (sizes > 0)))
            if len(wrong):
                raise UsageError(
                    f"{name} is {sizes[wrong[0]]}", place=f"actor {self.ids[wrong[0]]!r}", expected="a positive number"
                )
        absent = np.flatnonzero(~self.present[:, 0])
        if len(absent):
            raise UsageError("the ego (actor 0) is absent", place=f"stamp {self.stamps_ns[absent[0]]}")
        if not np.isfinite(self.rear_axle_to_center_m):
            raise UsageError(f"rear_axle_to_center_m is {self.rear_axle_to_center_m}", expected="a finite number")
        shown = self.shown_signals
        if shown.shape != (stamps, len(self.signals)) or (shown.size and not 0 <= shown.min() <= shown.max() < 4):
            raise UsageError(
                f"signal_states has shape {shown.shape}",
                expected=f"({stamps}, {len(self.signals)}) indices of the states {', '.join(SIGNAL_STATES)}",
            )

    def _shape(self) -> tuple[int, int]:
        stamps = np.asarray(self.stamps_ns)
        if stamps.ndim != 1 or len(stamps) == 0 or stamps.dtype != np.int64:
            raise UsageError(
                f"stamps_ns has shape {stamps.shape} and type {stamps.dtype}",
                expected="(T,) int64 with at least one stamp",
            )
        if (np.diff(stamps) <= 0).any():
            raise UsageError("stamps_ns does not increase", place=f"row {np.argmax(np.diff(stamps) <= 0) + 1}")
        if not self.ids or len(set(self.ids)) != len(self.ids) or len(self.categories) != len(self.ids):
            raise UsageError(
                f"{len(self.ids)} ids and {len(self.categories)} categories",
                expected="one category for each actor, distinct ids, and the ego as actor 0",
            )
        return len(stamps), len(self.ids)

    def _array(self, name: str, kind: type, shape: tuple[int, ...]) -> Float64:
        values = np.asarray(getattr(self, name))
        if values.shape != shape or values.dtype != kind:
            raise UsageError(
                f"{name} has shape {values.shape} and type {values.dtype}", expected=f"{shape} {np.dtype(kind)}"
            )
        return values

    @property
    def shown_signals(self) -> npt.NDArray[np.int8]:
        """(T, S) states of the signals: ``signal_states``, or an empty array."""
        return np.zeros((len(self.stamps_ns), 0), np.int8) if self.signal_states is None else self.signal_states

    @property
    def times_s(self) -> Float64:
        """(T,) seconds since the first stamp."""
        seconds: Float64 = (self.stamps_ns - self.stamps_ns[0]) * 1e-9
        return seconds

    def stamp_at(self, time_s: float) -> int:
        """Convert a time in seconds since the first stamp to a stamp in nanoseconds."""
        return int(self.stamps_ns[0]) + round(time_s * 1e9)

    def kernel_arrays(self) -> tuple[Float64, Float64, Bool]:
        """Return the arrays for the compiled kernels, which must not be changed: they are computed once.

        Returns:
            (N, T, 5) x, y, yaw, vx, vy with the ego's first position as origin and continuous yaws, so that headings
            can be interpolated linearly; (N, 2) half lengths and half widths; (N, T) presence.
        """
        return self._kernel_arrays

    @cached_property
    def _kernel_arrays(self) -> tuple[Float64, Float64, Bool]:
        present = np.ascontiguousarray(self.present.T)
        states = np.empty((*present.shape, 5))
        columns = (self.x_m - self.x_m[0, 0], self.y_m - self.y_m[0, 0], self.yaw_rad, self.vx_mps, self.vy_mps)
        for column, values in enumerate(columns):
            states[:, :, column] = np.where(present, values.T, 0.0)
        steps = np.diff(states[:, :, 2], axis=1)
        steps -= 2.0 * np.pi * np.round(steps / (2.0 * np.pi))
        states[:, 1:, 2] = states[:, :1, 2] + np.cumsum(steps, axis=1)
        return states, 0.5 * np.stack([self.length_m, self.width_m], axis=1), present
