"""The recording vehicle: the parts of its body that its own cameras can see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Literal, NamedTuple

from mirror.synth.model import Label, Material, Model, Side
from mirror.synth.road_users.buses import add_bus_body, design_bus
from mirror.synth.road_users.coachwork.cab import FLOOR_M, Cab, add_cab_body
from mirror.synth.road_users.coachwork.design import CoachworkDesign, add_body, design_car
from mirror.synth.road_users.coachwork.sheets import SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import Shape
from mirror.synth.road_users.vans import design_van

_COWL_M: Final = 0.6
_COWL_RISE: Final = 0.07

EgoKind = Literal["saloon", "hatchback", "estate", "suv", "van", "truck", "bus"]


class Measures(NamedTuple):
    """Outer dimensions of a vehicle, in metres.

    Attributes:
        length: overall length.
        width: width without mirrors.
        height: height of the roof.
        wheelbase: distance between the axles.
        rear: distance from the rear axle to the rear end.
    """

    length: float
    width: float
    height: float
    wheelbase: float
    rear: float

    @property
    def overhangs(self) -> tuple[float, float]:
        """Front and rear overhang."""
        return self.length - self.wheelbase - self.rear, self.rear


_PAINTS: Final[Mapping[EgoKind, tuple[float, float, float]]] = {
    "saloon": (0.03, 0.06, 0.16),
    "hatchback": (0.27, 0.02, 0.02),
    "estate": (0.10, 0.105, 0.115),
    "suv": (0.20, 0.205, 0.215),
    "van": (0.60, 0.60, 0.59),
    "truck": (0.60, 0.60, 0.59),
    "bus": (0.56, 0.36, 0.02),
}


def make_ego_body(kind: EgoKind, measures: Measures) -> Model:
    """Build a vehicle without wheels, mirrors and windscreen, in its ego frame.

    Cameras may be inside the body: its sheets are not visible from inside.

    Args:
        kind: kind of vehicle.
        measures: outer dimensions.
    """
    sheets = Sheets(Label.EGO)
    paint = SheetFinish(_PAINTS[kind], Material.PAINT)
    if kind == "bus":
        shape = design_bus(
            measures.length, measures.height, waist=1.10, overhangs=measures.overhangs, width=measures.width
        )
        add_bus_body(sheets, shape, paint, paint, pitch_m=1.42)
    elif kind == "truck":
        _add_truck(sheets, measures, paint)
    else:
        design = _DESIGNS[kind](measures)
        add_body(sheets, design, paint)
        _extend_bonnet(sheets, design.shape, paint)
    model = sheets.model()
    screen = (model.faces["material"] == Material.GLASS) & (model.faces["side"] == Side.FRONT)
    bare = Model(model.faces[~screen], model.corners, model.rounds)
    return bare.place(0.5 * measures.length - measures.rear, 0.0)


def _extend_bonnet(sheets: Sheets, shape: Shape, paint: SheetFinish) -> None:
    """Extend the bonnet below the cameras, which would otherwise see a dashboard."""
    (x, z), rise = shape.roof[0], _COWL_RISE * _COWL_M
    half = shape.side_m(z) - 0.01
    corners = [(x, half, z), (x, -half, z), (x - _COWL_M, -half, z + rise), (x - _COWL_M, half, z + rise)]
    sheets.sheet(corners, Side.TOP, paint)


def _add_truck(sheets: Sheets, measures: Measures, paint: SheetFinish) -> None:
    end = 0.5 * measures.length
    cab = Cab(end - 1.9, end, 2.86, 0.48)
    add_cab_body(sheets, cab, paint, paint)
    half = 0.5 * measures.width
    walls = (Side.LEFT, Side.RIGHT, Side.FRONT, Side.BACK, Side.TOP)
    sheets.block((-end, -half, FLOOR_M - 0.06), (cab.back - 0.12, half, measures.height), paint, walls)


def _design_saloon(measures: Measures) -> CoachworkDesign:
    return design_car(
        measures.length, measures.width, measures.height, overhangs=measures.overhangs,
        clearance=0.16, waist=0.672 * measures.height, wheel=0.335, cowl=-0.40, screen_deg=28.0, nose=0.72,
        roof_end=(1.32, 0.065), tail=0.58, pillar=0.14, rise=0.02, rear_window=0.05,
    )  # fmt: skip


def _design_hatchback(measures: Measures) -> CoachworkDesign:
    return design_car(
        measures.length, measures.width, measures.height, overhangs=measures.overhangs,
        clearance=0.17, waist=0.658 * measures.height, wheel=0.325, cowl=-0.24, screen_deg=29.0, nose=0.74,
        roof_end=(0.5, 0.07), tail=0.16, pillar=0.28,
    )  # fmt: skip


def _design_estate(measures: Measures) -> CoachworkDesign:
    return design_car(
        measures.length, measures.width, measures.height, overhangs=measures.overhangs,
        clearance=0.16, waist=0.66 * measures.height, wheel=0.33, cowl=-0.38, screen_deg=28.5, nose=0.73,
        roof_end=(0.42, 0.06), tail=0.155, pillar=0.18,
    )  # fmt: skip


def _design_suv(measures: Measures) -> CoachworkDesign:
    return design_car(
        measures.length, measures.width, measures.height, overhangs=measures.overhangs,
        clearance=0.21, waist=0.66 * measures.height, wheel=0.36, cowl=-0.34, screen_deg=33.0, nose=0.90,
        roof_end=(0.46, 0.06), tail=0.165, pillar=0.25, lean=0.27,
    )  # fmt: skip


def _design_van(measures: Measures) -> CoachworkDesign:
    return design_van(
        measures.length, measures.width, measures.height, overhangs=measures.overhangs,
        waist=1.22, wheel=0.345, cowl=0.12, screen_deg=44.0, nose=1.02,
    )  # fmt: skip


_DESIGNS: Final[Mapping[EgoKind, Callable[[Measures], CoachworkDesign]]] = {
    "saloon": _design_saloon,
    "hatchback": _design_hatchback,
    "estate": _design_estate,
    "suv": _design_suv,
    "van": _design_van,
}
