"""Tests of furniture: it stands on its foot, faces +x, and has few faces."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.arrays import Float64
from mirror.synth.model import Label, Material, Model
from mirror.synth.street import furniture
from mirror.synth.street.furniture.small import Maker
from mirror.synth.textures.catalogue import BILLBOARDS, Sign
from tests.synth.street.rays import seen_from_behind

MAKERS = tuple(
    dict.fromkeys(
        (
            *furniture.PAVEMENT, *furniture.PARK, *furniture.ROADSIDE, furniture.billboard, furniture.high_billboard,
            furniture.city_light, furniture.advertising_column, furniture.bus_shelter, furniture.direction_sign,
        )
    )
)  # fmt: skip
LINE = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.2], [19.0, 3.0, 0.5]])


def named(maker: Maker) -> str:
    return maker.__name__


@pytest.mark.parametrize("maker", MAKERS, ids=named)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_small_furniture_stands_on_its_foot(maker: Maker, seed: int) -> None:
    model = maker(np.random.default_rng(seed))
    low, high = model.bounds()
    assert len(model) <= 130
    assert low[2] <= 0.0 < high[2] < 12.0
    assert (high - low)[:2].max() < 9.0
    assert seen_from_behind(Model(model.faces, model.corners, model.rounds[:0]), 250, seed) == []
    assert maker(np.random.default_rng(seed)).corners.tobytes() == model.corners.tobytes()


def test_billboards_change_between_traversals() -> None:
    faces = furniture.billboard(np.random.default_rng(4)).faces
    images = faces[faces["material"] == Material.LIT_IMAGE]
    assert len(images) == 1
    np.testing.assert_allclose(images["normal"], [[1.0, 0.0, 0.0]], atol=1e-12)
    for number in range(60):
        faces = furniture.billboard(np.random.default_rng(number)).faces
        one = faces[faces["material"] == Material.LIT_IMAGE][0]
        assert one["images"] == 4
        assert one["image"] in BILLBOARDS
        assert one["image"] + one["images"] - 1 in BILLBOARDS
        assert one["half"][0] / one["half"][1] == pytest.approx(1.5)


@pytest.mark.parametrize("sign", list(Sign))
def test_signs_show_their_image_upright(sign: Sign) -> None:
    model = furniture.traffic_sign((sign,), size_m=0.6)
    image = model.faces[model.faces["image"] == int(sign)]
    assert len(image) == 1
    np.testing.assert_allclose(image["normal"], [[1.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(image["u_axis"], [[0.0, 1.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(image["v_axis"], [[0.0, 0.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(image["half"], [[0.3, 0.3]], atol=1e-9)
    corners = model.corners[image["first"][0] : image["first"][0] + image["count"][0]]
    u, v = corners @ image["u_axis"][0] + image["u0"], corners @ image["v_axis"][0] + image["v0"]
    assert np.abs(u).max() <= 0.3 + 1e-9
    assert np.abs(v).max() <= 0.3 + 1e-9


@pytest.mark.parametrize("reach", [0.0, 4.5, -4.5])
def test_traffic_light_lamps_are_indexed_by_colour(reach: float) -> None:
    light = furniture.traffic_light(reach)
    heads = 2 if reach else 1
    heights: list[Float64] = []
    for numbers, strongest in ((light.red, 0), (light.amber, 0), (light.green, 1)):
        faces = light.model.faces[numbers]
        assert len(faces) == heads
        assert (faces["material"] == Material.SIGNAL).all()
        assert (faces["label"] == Label.TRAFFIC_LIGHT).all()
        assert (faces["colour"].argmax(axis=1) == strongest).all()
        np.testing.assert_allclose(faces["normal"], [[1.0, 0.0, 0.0]] * heads, atol=1e-9)
        corners = [light.model.corners[f["first"] : f["first"] + f["count"]] for f in faces]
        heights.append(np.array([ring[:, 2].mean() for ring in corners]))
        if reach:
            assert corners[1][:, 1].mean() == pytest.approx(reach)
    assert (heights[0] > heights[1]).all()
    assert (heights[1] > heights[2]).all()
    lit = np.concatenate([light.red, light.amber, light.green])
    assert (light.model.faces["material"] == Material.SIGNAL).sum() == len(lit) == 3 * heads


@pytest.mark.parametrize(
    ("kind", "height", "count"), [("arm", 8.0, 1), ("double", 9.0, 2), ("column", 4.6, 1), ("lantern", 4.3, 1)]
)
def test_street_lamps_give_their_light_positions(kind: furniture.LampKind, height: float, count: int) -> None:
    post = furniture.lamp_post(kind, height_m=height)
    assert post.lights.shape == (count, 3)
    glow = post.model.faces[post.model.faces["material"] == Material.STREET_LAMP]
    middles = np.array([post.model.corners[f["first"] : f["first"] + f["count"]].mean(axis=0) for f in glow])
    for light in post.lights:
        assert np.linalg.norm(middles - light, axis=1).min() < 0.5
    assert len(post.model) < 45


@pytest.mark.parametrize("span", [14.0, -14.0])
def test_a_gantry_spans_the_road(span: float) -> None:
    model = furniture.gantry(np.random.default_rng(1), span)
    low, high = model.bounds()
    assert low[1] == pytest.approx(min(0.0, span) - 0.22)
    assert high[1] == pytest.approx(max(0.0, span) + 0.22)
    over = model.corners[(np.abs(model.corners[:, 1] - 0.5 * span) < 5.0)]
    assert over[:, 2].min() > 5.0


@pytest.mark.parametrize("kind", ["guard", "fence", "wall"])
def test_rails_follow_their_line(kind: str) -> None:
    rng = np.random.default_rng(0)
    model = {
        "guard": lambda: furniture.guard_rail(LINE),
        "fence": lambda: furniture.fence(rng, LINE),
        "wall": lambda: furniture.garden_wall(rng, LINE),
    }[kind]()
    low, high = model.bounds()
    assert low[0] == pytest.approx(0.0, abs=0.2)
    assert high[0] == pytest.approx(19.0, abs=0.2)
    for face in model.faces:
        corners = model.corners[face["first"] : face["first"] + face["count"]]
        np.testing.assert_allclose(corners @ face["normal"], face["offset"], atol=1e-9)
    assert 0.7 < high[2] < 1.8


def test_wires_hang_between_poles() -> None:
    model = furniture.power_line(np.array([[0.0, 0.0, 0.0], [40.0, 5.0, 1.0]]), height_m=8.5, sag_m=0.6)
    wires = model.faces[(model.faces["label"] == Label.POLE) & (model.faces["material"] == Material.PLAIN)]
    places = np.concatenate([model.corners[f["first"] : f["first"] + f["count"]] for f in wires])
    middle = places[np.abs(places[:, 0] - 20.0) < 3.5]
    assert middle[:, 2].min() == pytest.approx(0.5 + 8.5 - 0.4 + 0.16 - 0.6, abs=0.15)
    assert len(model) < 200
