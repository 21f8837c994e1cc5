"""Which frames of a traversal are generated, and from where: frames at a rate, along a trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.generation.scenes.scene_clip import PlannedFrame
from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.geometry.interpolation import interpolate
from mirror.protocols.views.trajectories import parse_trajectory

DEFAULT_HZ: Final = 5.0
"""Frames per second of a generator whose file states no rate: those of the clips of the synthetic street."""
_RATE_TOLERANCE: Final = 1.05


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """The frames of a traversal at a rate; the first T frames seed the rollout and are not generated.

    Attributes:
        frames: seeds first.
        rate_hz: frames per second.
        light: light of the traversal.
        weather: weather of the traversal.
        tracks: numbers of its road users by track id.
    """

    frames: tuple[PlannedFrame, ...]
    rate_hz: float
    light: str
    weather: str
    tracks: dict[str, int]


def choose_stride(timestamp_ns: Int64, hz: float | None, default_hz: float = DEFAULT_HZ) -> tuple[int, float]:
    """Choose the stride: one of how many frames of a recording is used.

    Args:
        timestamp_ns: (N,) times of its frames, N at least 2.
        hz: wanted rate; None: `default_hz`, or the rate of the recording if that is lower.
        default_hz: rate where none is wanted.

    Returns:
        The stride, and the rate of the recording in frames per second.

    Raises:
        UsageError: the wanted rate is above that of the recording.
    """
    recorded_hz = 1e9 / float(np.median(np.diff(timestamp_ns)))
    if hz is not None and hz > _RATE_TOLERANCE * recorded_hz:
        raise UsageError(
            f"{hz:g} frames per second",
            place="--hz",
            expected=f"at most {recorded_hz:.3g}, the rate of the recording",
            remedy="leave it out, or choose a lower one",
        )
    return max(1, round(recorded_hz / (hz or default_hz))), recorded_hz


def plan_scene(
    dataset: Dataset,
    traversal_id: str,
    *,
    hz: float | None,
    trajectory: str | None,
    references: int,
    count: int | None,
    trained_hz: float = DEFAULT_HZ,
) -> ScenePlan:
    """Plan the frames of one traversal.

    Args:
        dataset: the dataset.
        traversal_id: the traversal.
        hz: wanted rate; the nearest rate that takes every so many frames is used. None: `trained_hz`, or the rate of
            the recording if that is lower.
        trajectory: line of the vehicle in the generated frames, as for `mirror render`; None: the recorded one.
        references: T, number of seeds.
        count: largest number of generated frames; None: all.
        trained_hz: rate of the generator's training.

    Raises:
        UsageError: the traversal has too few frames, the rate is above that of the recording, or the trajectory is
            unknown.
    """
    frames = dataset.where(traversal=traversal_id).frames()
    stamps = np.array([frame.timestamp_ns for frame in frames], np.int64)
    if len(stamps) < 2:
        raise UsageError(f"{len(stamps)} frames", place=traversal_id, expected=f"at least {references + 1}")
    stride, recorded_hz = choose_stride(stamps, hz, trained_hz)
    chosen = np.arange(0, len(frames), stride)
    if count is not None:
        chosen = chosen[: references + count]
    if len(chosen) <= references:
        raise UsageError(
            f"{len(chosen)} frames at {recorded_hz / stride:.3g} Hz",
            place=traversal_id,
            expected=f"at least {references + 1}: {references} seed the rollout and are not generated",
            remedy="choose a longer traversal, or a higher --hz",
        )
    poses = interpolate(*frames[0].track, stamps[chosen])
    if trajectory is not None:
        line = parse_trajectory(dataset, trajectory, traversal_id, recorded_hz / stride)
        # Another traversal or a file has stamps of its own: the time since the first pose is what both share.
        times = line.timestamps_ns[0] + (stamps[chosen] - stamps[0])
        within = times <= line.timestamps_ns[-1]
        chosen, times = chosen[within], times[within]
        if len(chosen) <= references:
            raise UsageError(
                f"a trajectory of {(line.timestamps_ns[-1] - line.timestamps_ns[0]) * 1e-9:.3g} s",
                place="--trajectory",
                expected=f"longer than {references} frames",
            )
        moved = interpolate(line.timestamps_ns, line.world_SE3_ego, times)
        planned = tuple(
            # Seeds are recorded images, so they stay where they were recorded.
            PlannedFrame(frames[int(row)], poses[place] if place < references else moved[place])
            for place, row in enumerate(chosen)
        )
    else:
        planned = tuple(PlannedFrame(frames[int(row)], poses[place]) for place, row in enumerate(chosen))
    row = dataset.where(traversal=traversal_id).table("traversals", ["light", "weather"]).to_pylist()[0]
    tracks = {name: number for number, name in enumerate(frames[0].track_ids)}
    return ScenePlan(planned, recorded_hz / stride, row["light"], row["weather"], tracks)
