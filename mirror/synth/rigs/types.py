"""The seven vehicle types, each with its own rig of seven cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from mirror.geometry.rolling_shutter import ShutterDirection
from mirror.synth.rigs.mount import Mount, Optics, SensorRaster
from mirror.synth.road_users.ego import EgoKind


@dataclass(frozen=True)
class Size:
    """The dimensions of a vehicle. The origin of the ego frame is on the ground below the rear axle.

    Attributes:
        length_m: total length.
        width_m: width without mirrors.
        height_m: total height.
        wheelbase_m: distance between the axles.
        rear_m: distance from the rear axle to the rear end.
    """

    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    rear_m: float

    @property
    def middle_m(self) -> float:
        """Distance from the rear axle forward to the middle of the vehicle."""
        return 0.5 * self.length_m - self.rear_m


@dataclass(frozen=True)
class VehicleType:
    """A type of recording vehicle with its camera rig.

    Attributes:
        name: name of the vehicle type.
        size: dimensions of the vehicle.
        mounts: seven cameras in canonical order.
        exposure_ns: exposure time of one row.
        stagger_ns: delay of each camera's exposure against the previous camera.
        shutter: direction in which the rows are exposed.
        readout_ns: time from the start of the first row's exposure to the start of the last row's exposure.
    """

    name: EgoKind
    size: Size
    mounts: tuple[Mount, ...]
    exposure_ns: int
    stagger_ns: int = 0
    shutter: ShutterDirection = "global"
    readout_ns: int = 0


@dataclass(frozen=True)
class _Head:
    """The two forward cameras: the wide one in the middle, the narrow one beside it."""

    wide: Optics
    narrow: Optics
    raster: SensorRaster
    narrow_raster: SensorRaster
    place_m: tuple[float, float, float]
    aside_m: float
    pitch_deg: float


@dataclass(frozen=True)
class _Pair:
    """A left camera and its mirror image on the right; positive angles are to the left and upwards."""

    optics: Optics
    raster: SensorRaster
    place_m: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float

    def mounts(self, name: str) -> tuple[Mount, Mount]:
        x, y, z = self.place_m
        return (
            Mount(f"{name}_left", self.optics, self.raster, (x, y, z), self.yaw_deg, self.pitch_deg),
            Mount(f"{name}_right", self.optics, self.raster, (x, -y, z), -self.yaw_deg, self.pitch_deg),
        )


@dataclass(frozen=True)
class _Tail:
    """The rear camera."""

    optics: Optics
    raster: SensorRaster
    place_m: tuple[float, float, float]
    pitch_deg: float


def _rig(head: _Head, front: _Pair, rear: _Pair, tail: _Tail) -> tuple[Mount, ...]:
    """Return all seven cameras, in canonical order."""
    x, y, z = head.place_m
    return (
        Mount("front_wide", head.wide, head.raster, head.place_m, 0.0, head.pitch_deg),
        Mount("front_narrow", head.narrow, head.narrow_raster, (x, y + head.aside_m, z), 0.0, 0.3 * head.pitch_deg),
        *front.mounts("front"),
        *rear.mounts("rear"),
        Mount("rear", tail.optics, tail.raster, tail.place_m, 180.0, tail.pitch_deg),
    )


_HD: Final = SensorRaster(1.0, 16 / 9)
_TALL: Final = SensorRaster(1.0, 1.59)
_SMALL: Final = SensorRaster(0.8, 1.5)
_LOW: Final = SensorRaster(0.75, 1.6)
_FINE: Final = SensorRaster(1.2, 1.84)
_SQUARE: Final = SensorRaster(0.9, 4 / 3)

SALOON: Final = VehicleType(
    name="saloon",
    size=Size(4.85, 1.85, 1.45, 2.85, 1.08),
    mounts=_rig(
        _Head(
            Optics("kannala_brandt", 122.0, (-0.012, 0.004, -0.002, 0.0)),
            Optics("pinhole", 34.0),
            _HD, _HD, (1.75, 0.0, 1.36), 0.08, -2.0,
        ),
        _Pair(Optics("pinhole", 92.0), _HD, (2.2, 0.93, 1.05), 62.0, -4.0),
        _Pair(Optics("pinhole", 84.0), _HD, (2.5, 0.93, 0.95), 138.0, -4.0),
        _Tail(Optics("brown_conrady", 96.0, (-0.13, 0.012, 0.0003, -0.0002, 0.0)), _HD, (-1.05, 0.0, 1.05), -6.0),
    ),
    exposure_ns=8_000_000,
)  # fmt: skip
HATCHBACK: Final = VehicleType(
    name="hatchback",
    size=Size(4.20, 1.79, 1.49, 2.62, 0.76),
    mounts=_rig(
        _Head(
            Optics("f_theta", 120.0, (0.0, 1.0, 0.0, -0.035, 0.004)),
            Optics("f_theta", 30.0, (0.0, 1.0, 0.0, 0.31)),
            _TALL, _TALL, (1.48, 0.0, 1.38), -0.07, -3.0,
        ),
        _Pair(Optics("f_theta", 118.0, (0.0, 1.0, 0.0, -0.035, 0.004)), _TALL, (1.95, 0.92, 1.02), 68.0, -6.0),
        _Pair(Optics("f_theta", 72.0, (0.0, 1.0, 0.0, 0.12)), _TALL, (2.15, 0.92, 0.92), 146.0, -3.0),
        _Tail(Optics("f_theta", 118.0, (0.0, 1.0, 0.0, -0.035, 0.004)), _TALL, (-0.72, 0.0, 1.15), -9.0),
    ),
    exposure_ns=5_000_000,
    stagger_ns=1_500_000,
)  # fmt: skip
ESTATE: Final = VehicleType(
    name="estate",
    size=Size(4.82, 1.84, 1.47, 2.86, 1.06),
    mounts=_rig(
        _Head(
            Optics("brown_conrady", 100.0, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
            Optics("brown_conrady", 36.0, (-0.08, 0.03, 0.0, 0.0003, 0.0)),
            _SMALL, _SMALL, (1.35, 0.0, 1.68), 0.12, -4.0,
        ),
        _Pair(Optics("brown_conrady", 80.0, (-0.14, 0.02, 0.0004, 0.0, 0.0)), _SMALL, (1.15, 0.55, 1.70), 58.0, -5.0),
        _Pair(Optics("brown_conrady", 80.0, (-0.14, 0.02, 0.0, 0.0004, 0.0)), _SMALL, (-0.20, 0.55, 1.70), 118.0, -5.0),
        _Tail(Optics("brown_conrady", 80.0, (-0.14, 0.02, 0.0, 0.0, 0.0)), _SMALL, (-0.50, 0.0, 1.70), -5.0),
    ),
    exposure_ns=6_000_000,
    stagger_ns=8_000_000,
)  # fmt: skip
SUV: Final = VehicleType(
    name="suv",
    size=Size(4.72, 1.92, 1.71, 2.80, 1.00),
    mounts=_rig(
        _Head(
            Optics("rational", 112.0, (0.62, 0.05, 0.0003, -0.0002, 0.001, 0.95, 0.16, 0.008)),
            Optics("rational", 32.0, (0.30, -0.10, 0.0, 0.0, 0.0, 0.36, -0.06, 0.0)),
            _FINE, _FINE, (1.62, 0.0, 1.52), 0.09, -3.0,
        ),
        _Pair(
            Optics("rational", 96.0, (0.62, 0.05, 0.0, 0.0002, 0.001, 0.95, 0.16, 0.008)),
            _LOW, (2.05, 0.99, 1.12), 64.0, -5.0,
        ),
        _Pair(Optics("pinhole", 78.0), _LOW, (2.45, 0.97, 1.02), 140.0, -4.0),
        _Tail(Optics("kannala_brandt", 128.0, (-0.020, 0.003, -0.001, 0.0)), _LOW, (-1.02, 0.0, 1.10), -12.0),
    ),
    exposure_ns=10_000_000,
)  # fmt: skip
VAN: Final = VehicleType(
    name="van",
    size=Size(5.53, 2.02, 2.36, 3.40, 1.05),
    mounts=_rig(
        _Head(
            Optics("brown_conrady", 100.0, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
            Optics("pinhole", 30.0),
            _HD, _HD, (3.05, 0.0, 1.92), -0.08, -5.0,
        ),
        _Pair(Optics("pinhole", 92.0), _HD, (2.6, 1.17, 1.75), 62.0, -4.0),
        _Pair(Optics("pinhole", 84.0), _HD, (2.9, 1.17, 1.65), 142.0, -4.0),
        _Tail(Optics("pinhole", 96.0), _HD, (-1.10, 0.0, 1.75), -6.0),
    ),
    exposure_ns=6_000_000,
    stagger_ns=3_000_000,
)  # fmt: skip
TRUCK: Final = VehicleType(
    name="truck",
    size=Size(8.40, 2.50, 3.40, 4.90, 2.05),
    mounts=_rig(
        _Head(
            Optics("rational", 104.0, (0.40, 0.02, -0.0002, 0.0003, 0.0, 0.66, 0.10, 0.003)),
            Optics("brown_conrady", 28.0, (-0.05, 0.0, 0.0, 0.0, 0.0)),
            _HD, _HD, (6.28, 0.0, 2.55), 0.15, -7.0,
        ),
        _Pair(Optics("kannala_brandt", 124.0, (-0.015, 0.002, 0.0, 0.0)), _LOW, (6.10, 1.46, 2.62), 70.0, -14.0),
        _Pair(Optics("kannala_brandt", 96.0, (-0.015, 0.002, 0.0, 0.0)), _LOW, (6.10, 1.46, 2.46), 140.0, -12.0),
        _Tail(Optics("kannala_brandt", 132.0, (-0.015, 0.002, 0.0, 0.0)), _LOW, (-2.15, 0.0, 2.70), -20.0),
    ),
    exposure_ns=7_000_000,
    stagger_ns=2_000_000,
)  # fmt: skip
BUS: Final = VehicleType(
    name="bus",
    size=Size(12.00, 2.55, 3.10, 5.90, 3.40),
    mounts=_rig(
        _Head(
            Optics("f_theta", 126.0, (0.0, 1.0, 0.0, -0.030, 0.002)),
            Optics("pinhole", 40.0),
            _SQUARE, _SQUARE, (8.52, 0.0, 2.70), 0.10, -9.0,
        ),
        _Pair(
            Optics("f_theta", 120.0, (0.0, 1.0, 0.0, -0.030, 0.002)), _SQUARE, (8.30, 1.46, 2.75), 72.0, -16.0,
        ),
        _Pair(
            Optics("f_theta", 100.0, (0.0, 1.0, 0.0, -0.020, 0.001)), _SQUARE, (8.05, 1.46, 2.60), 138.0, -14.0,
        ),
        _Tail(
            Optics("f_theta", 130.0, (0.0, 1.0, 0.0, -0.030, 0.002)), _SQUARE, (-3.50, 0.0, 2.70), -22.0,
        ),
    ),
    exposure_ns=12_000_000,
    stagger_ns=5_000_000,
)  # fmt: skip

VEHICLE_TYPES: Final[Mapping[str, VehicleType]] = {
    one.name: one for one in (SALOON, HATCHBACK, ESTATE, SUV, VAN, TRUCK, BUS)
}
"""All vehicle types, by name."""
