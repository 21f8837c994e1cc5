"""City driving for the trigger benchmark: a fleet on a road grid, with stops and some faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.recordings.protocol import Track
from mirror.schema.documents import Roi

BLOCK_M = 250.0
BLOCKS = 80  # a side, for ten million poses; fewer poses drive in a smaller city
CENTRE = (8.4037, 49.0069)
METRES_A_DEGREE = (73_100.0, 111_200.0)
PERIOD_S = 0.1
START_NS = 1_700_000_000_000_000_000
RADIUS_M = 200.0


@dataclass(frozen=True)
class Traffic:
    """One long track and the ROIs to test it against.

    Attributes:
        track: (N,) fixes at 10 Hz, some with faults.
        rois: circles near crossroads.
    """

    track: Track
    rois: list[Roi]


def traffic(poses: int, rois: int, seed: int = 0) -> Traffic:
    """Generate driving between way-points on a grid of roads: 6 to 15 m/s, a stop at every third crossroads.

    Args:
        poses: number of fixes of the track.
        rois: number of ROIs, near random crossroads.
        seed: seed of the generator.
    """
    rng = np.random.default_rng(seed)
    blocks = max(4, round(BLOCKS * (poses / 1e7) ** 0.5))
    t, xy = _route(rng, blocks, poses * PERIOD_S)
    now = np.arange(poses) * PERIOD_S
    x, y = (np.interp(now, t, axis) + rng.normal(0.0, 0.01, poses) for axis in xy.T)
    stamps = START_NS + np.rint(now * 1e9).astype(np.int64)
    lon, lat = CENTRE[0] + x / METRES_A_DEGREE[0], CENTRE[1] + y / METRES_A_DEGREE[1]
    stamps, lon, lat = _add_faults(rng, stamps, lon, lat)
    centres = (rng.integers(0, blocks + 1, (rois, 2)) - blocks / 2) * BLOCK_M + rng.uniform(-60.0, 60.0, (rois, 2))
    circles = [
        Roi(
            scene_id=f"roi_{number:03d}",
            longitude_deg=CENTRE[0] + east / METRES_A_DEGREE[0],
            latitude_deg=CENTRE[1] + north / METRES_A_DEGREE[1],
            radius_m=RADIUS_M,
        )
        for number, (east, north) in enumerate(centres.tolist())
    ]
    return Traffic(Track(timestamp_ns=stamps, longitude_deg=lon, latitude_deg=lat), circles)


def _route(rng: np.random.Generator, blocks: int, seconds: float) -> tuple[Float64, Float64]:
    """Times and places at every crossroads, arrival and departure."""
    place = np.array([blocks // 2, blocks // 2])
    times, places = [0.0], [(place - blocks / 2) * BLOCK_M]
    while times[-1] < seconds:
        target = rng.integers(0, blocks + 1, 2)
        for axis in rng.permutation(2):
            while place[axis] != target[axis]:
                place[axis] += np.sign(target[axis] - place[axis])
                times.append(times[-1] + BLOCK_M / rng.uniform(6.0, 15.0))
                places.append((place - blocks / 2) * BLOCK_M)
                if rng.random() < 1 / 3:
                    times.append(times[-1] + rng.uniform(2.0, 45.0))
                    places.append(places[-1])
    return np.array(times), np.array(places)


def _add_faults(rng: np.random.Generator, stamps: Int64, lon: Float64, lat: Float64) -> tuple[Int64, Float64, Float64]:
    """Add one in a thousand each of repeated fixes, equal stamps and wild fixes, some NaN, and a few gaps."""
    count = len(stamps)

    def some(share: float) -> Int64:
        return 1 + rng.integers(0, count - 1, max(1, round(share * count)))

    rows = some(1e-3)
    lon[rows], lat[rows] = lon[rows - 1], lat[rows - 1]
    rows = some(1e-3)
    stamps[rows] = stamps[rows - 1]
    rows = some(1e-3)
    lon[rows] += rng.uniform(0.001, 0.05, len(rows)) * rng.choice([-1.0, 1.0], len(rows))
    rows = some(1e-4)
    lat[rows] = np.nan
    stays = np.ones(count, bool)
    for start in some(2e-6):
        stays[start : start + rng.integers(30, 600)] = False
    return np.sort(stamps)[stays], lon[stays], lat[stays]
