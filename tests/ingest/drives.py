"""Drives for the trigger tests, built in metres and laid anywhere on the globe or in a plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64
from mirror.recordings.protocol import Track
from mirror.schema.documents import Roi

T0_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Place:
    """Where the metres of a drive lie: round a geodetic point, or in a local frame with an offset."""

    longitude_deg: float = 0.0
    latitude_deg: float = 0.0
    frame: str | None = None
    offset_m: float = 0.0

    @property
    def scale(self) -> tuple[float, float]:
        e2 = 0.0066943799901413165
        lat = math.radians(self.latitude_deg)
        inner = 1.0 - e2 * math.sin(lat) ** 2
        normal = 6378137.0 / math.sqrt(inner)
        return math.radians(normal * math.cos(lat)), math.radians(normal * (1.0 - e2) / inner)

    def coordinates(self, xy_m: Float64) -> tuple[Float64, Float64]:
        if self.frame is not None:
            return xy_m[:, 0] + self.offset_m, xy_m[:, 1] - self.offset_m
        sx, sy = self.scale
        lon = self.longitude_deg + xy_m[:, 0] / sx
        return np.where(lon > 180.0, lon - 360.0, lon), self.latitude_deg + xy_m[:, 1] / sy

    def track(self, t_s: Float64, xy_m: Float64, sigma_m: Float64 | None = None) -> Track:
        stamps = T0_NS + np.rint(np.asarray(t_s) * 1e9).astype(np.int64)
        first, second = self.coordinates(np.asarray(xy_m, np.float64))
        if self.frame is not None:
            return Track(timestamp_ns=stamps, x_m=first, y_m=second, sigma_m=sigma_m)
        return Track(timestamp_ns=stamps, longitude_deg=first, latitude_deg=second, sigma_m=sigma_m)

    def roi(self, x_m: float = 0.0, y_m: float = 0.0, radius_m: float = 200.0, scene_id: str = "scene") -> Roi:
        first, second = (float(axis[0]) for axis in self.coordinates(np.array([[x_m, y_m]])))
        if self.frame is not None:
            return Roi(scene_id=scene_id, frame=self.frame, x_m=first, y_m=second, radius_m=radius_m)
        return Roi(scene_id=scene_id, longitude_deg=first, latitude_deg=second, radius_m=radius_m)


PLANE = Place(frame="yard")
FAR_PLANE = Place(frame="yard", offset_m=1e6)
CITY = Place(8.4037, 49.0069)
EQUATOR = Place(0.0, 0.0)
SOUTH = Place(-70.65, -33.45)
ANTIMERIDIAN = Place(180.0, -16.5)
ARCTIC = Place(25.0, 89.0)
PLACES = {
    "plane": PLANE,
    "far plane": FAR_PLANE,
    "city": CITY,
    "equator": EQUATOR,
    "south": SOUTH,
    "antimeridian": ANTIMERIDIAN,
    "arctic": ARCTIC,
}


@dataclass
class Driver:
    """Writes a drive fix by fix, clean and dirty."""

    rng: np.random.Generator
    t: float = 0.0
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    fixes: list[tuple[float, float, float]] = field(default_factory=list)

    def fix(self, dx: float = 0.0, dy: float = 0.0) -> None:
        self.fixes.append((self.t, self.x + dx, self.y + dy))

    def drive(self, count: int) -> None:
        step, speed, turn = self.rng.choice([0.1, 0.5, 1.0]), self.rng.uniform(0.5, 30.0), self.rng.normal(0.0, 0.3)
        for _ in range(count):
            self.t += step
            self.heading += turn * step
            self.x += speed * step * math.sin(self.heading)
            self.y += speed * step * math.cos(self.heading)
            self.fix()

    def shuttle(self, count: int) -> None:
        for _ in range(count):
            self.heading += math.pi
            for _ in range(3):
                self.t += 1.0
                self.x += 4.0 * math.sin(self.heading)
                self.y += 4.0 * math.cos(self.heading)
                self.fix()

    def stand(self, count: int) -> None:
        noise = self.rng.choice([0.02, 0.1, 0.3])
        step = self.rng.choice([0.5, 1.9, 7.0])
        for _ in range(count):
            self.t += step
            self.fix(self.rng.normal(0.0, noise), self.rng.normal(0.0, noise))

    def repeat(self, count: int) -> None:
        if not self.fixes:
            self.fix()
        _, x, y = self.fixes[-1]
        moving, step = self.rng.uniform(0.0, 15.0), self.rng.choice([0.1, 1.0])
        for _ in range(count):
            self.t += step
            self.fixes.append((self.t, x, y))
        if self.rng.random() < 0.5:
            self.x += moving * count * step * math.sin(self.heading)
            self.y += moving * count * step * math.cos(self.heading)

    def gap(self, count: int) -> None:
        seconds = self.rng.uniform(0.5, 6.0)
        self.t += seconds
        self.x += count * 0.3 * seconds * math.sin(self.heading)
        self.y += count * 0.3 * seconds * math.cos(self.heading)

    def outliers(self, count: int) -> None:
        size, angle = 10 ** self.rng.uniform(0.5, 5.0), self.rng.uniform(0.0, 2.0 * math.pi)
        for _ in range(1 + count % 5):
            self.t += self.rng.choice([0.1, 1.0])
            spread = self.rng.choice([0.3, 300.0])
            dx, dy = size * math.sin(angle), size * math.cos(angle)
            self.fix(dx + self.rng.normal(0.0, spread), dy + self.rng.normal(0.0, spread))

    def jump(self, count: int) -> None:
        self.t += 0.3
        self.x += self.rng.normal(0.0, 400.0)
        self.y += self.rng.normal(0.0, 400.0)

    def duplicate(self, count: int) -> None:
        self.fix(self.rng.normal(0.0, 2.0), 0.0)

    def backward(self, count: int) -> None:
        if self.fixes:
            at = self.rng.integers(len(self.fixes))
            self.fixes.insert(int(at), (self.t + 1e-3 * count, self.x, self.y))

    def nothing(self, count: int) -> None:
        self.t += 0.1
        self.fix(self.rng.choice([math.nan, math.inf, 1e12]), 0.0)

    @classmethod
    def moves(cls) -> dict[str, Callable[[Driver, int], None]]:
        names = ["drive", "shuttle", "stand", "repeat", "gap", "outliers", "jump", "duplicate", "backward", "nothing"]
        return {name: getattr(cls, name) for name in names}

    def arrays(self) -> tuple[Float64, Float64]:
        table = np.array(self.fixes, np.float64).reshape(-1, 3)
        return table[:, 0], table[:, 1:]
