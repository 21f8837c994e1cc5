"""Tests of marking layouts that are restricted to the marks of each piece."""

import numpy as np
import pytest

from mirror.synth.model import FACE, Material, flat
from mirror.synth.render.carriageway import carriageway
from mirror.synth.roads.markings import MARK, restrict_layouts
from tests.synth.roads.scenes import plan


def test_restricted_layouts_paint_the_same_markings() -> None:
    scene = plan("urban")
    model, short = restrict_layouts(scene.ground, scene.layouts)
    rng = np.random.default_rng(7)
    paved = np.flatnonzero(scene.ground.faces["material"] == Material.ASPHALT)
    long, narrow = scene.layouts.view(flat(MARK)), short.view(flat(MARK))
    assert short.shape[1] < scene.layouts.shape[1]
    painted = 0
    for index in rng.choice(paved, 400, replace=False):
        face = scene.ground.faces[index]
        corners = scene.ground.corners[face["first"] : face["first"] + face["count"]]
        place = rng.dirichlet(np.ones(len(corners))) @ corners
        u, v = face["u_axis"] @ place + face["u0"], face["v_axis"] @ place + face["v0"]
        one = scene.ground.faces.view(flat(FACE))[index]
        other = model.faces.view(flat(FACE))[index]
        found = carriageway(one, long, 1.0, u, v, 1e-3, 1e-3)
        assert carriageway(other, narrow, 1.0, u, v, 1e-3, 1e-3) == pytest.approx(found, abs=1e-9)
        painted += found[0] > 0.3
    assert painted > 3
