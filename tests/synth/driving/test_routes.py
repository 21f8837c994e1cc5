"""Tests of named routes on hand-made and planned streets."""

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.schema.documents import Roi
from mirror.synth.driving.routes import ROUTES, available_routes, make_route
from mirror.synth.street.plan import plan_scene
from tests.traffic import street

NETWORK = street.network()


def driven(route) -> np.ndarray:
    return route.way.points[int(2 * route.begin_m) : int(2 * route.end_m) + 1]


def turned_deg(route) -> float:
    heading = route.way.heading_rad[int(2 * route.begin_m) : int(2 * route.end_m) + 1]
    return float(np.degrees(heading[-1] - heading[0]))


def test_routes_match_their_names() -> None:
    routes = {name: make_route(name, NETWORK, street.RADIUS) for name in available_routes(NETWORK, street.RADIUS)}
    assert set(routes) == set(ROUTES) - {"other", "change", "leave", "join"}
    assert turned_deg(routes["along"]) == pytest.approx(0.0, abs=1.0)
    assert turned_deg(routes["turn"]) == pytest.approx(-90.0, abs=2.0)
    assert turned_deg(routes["left"]) == pytest.approx(90.0, abs=2.0)
    assert turned_deg(routes["twice"]) == pytest.approx(180.0, abs=2.0)
    along, back, across = (driven(routes[name]) for name in ("along", "back", "across"))
    assert np.dot(along[-1] - along[0], back[-1] - back[0]) < 0.0
    assert abs(np.dot(along[-1] - along[0], across[-1] - across[0])) < 1e-6
    for name in ("along", "back", "turn", "left", "across"):
        radius = np.hypot(*driven(routes[name]).T)
        assert min(radius[0], radius[-1]) > street.RADIUS + 20.0
        assert radius.min() < 0.5 * street.RADIUS


def test_routes_keep_to_parallel_lanes_and_change_between_them() -> None:
    network = street.motorway()
    first, second = (driven(make_route("along", network, street.RADIUS, variant)) for variant in (0, 1))
    assert first[:, 1] == pytest.approx(0.0)
    assert second[:, 1] == pytest.approx(3.6)
    change = driven(make_route("change", network, street.RADIUS))
    assert change[0, 1] == pytest.approx(0.0)
    assert change[:, 1].max() == pytest.approx(3.6, abs=1e-6)


def test_routes_that_a_scene_lacks_are_refused() -> None:
    with pytest.raises(UsageError, match="no route 'turn' in this scene"):
        make_route("turn", street.motorway(), street.RADIUS)
    with pytest.raises(UsageError, match="no route 'sideways'"):
        make_route("sideways", NETWORK, street.RADIUS)
    with pytest.raises(UsageError, match="no room to turn round"):
        make_route("uturn", street.motorway(), street.RADIUS)


@pytest.mark.parametrize(
    ("kind", "radius", "missing"),
    [
        ("urban", 62.0, {"other", "change", "leave", "join"}),
        ("campus", 120.0, {"other", "change", "leave", "join"}),
        ("rural", 200.0, {"across", "other", "change", "leave", "join"}),
        ("highway", 200.0, {"turn", "left", "across", "edge", "corner", "twice", "uturn"}),
    ],
)
def test_planned_scenes_have_the_expected_routes(kind, radius, missing) -> None:
    plan = plan_scene(
        Roi(scene_id="a", longitude_deg=8.0, latitude_deg=49.0, radius_m=radius, scene_type=kind), 24.0, 3
    )
    assert set(available_routes(plan.network, radius)) >= set(ROUTES) - missing
    for name in sorted(set(ROUTES) - missing):
        way = make_route(name, plan.network, radius).way
        bend = np.abs(np.diff(way.heading_rad)) / 0.5
        assert bend.max() < 1 / 4.0, name
