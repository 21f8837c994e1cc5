"""Tests of arrays that hold the surfaces of one instant after the other, against surfaces merged for each instant."""

import numpy as np

from mirror.synth.model import FACE, ROUND, Model, flat, merge_models
from mirror.synth.render.binning import bounding_spheres
from mirror.synth.render.surfaces import SurfaceBuffer
from tests.synth.render.scenes import random_model


def spheres_of(model: Model) -> np.ndarray:
    return bounding_spheres(model.faces.view(flat(FACE)), model.corners, model.rounds.view(flat(ROUND)))


def test_each_instant_has_the_surfaces_that_are_merged_for_it() -> None:
    rng = np.random.default_rng(3)
    streets = [random_model(rng, 30), random_model(rng, 20)]
    moving = [random_model(rng, count) if count else Model.empty() for count in (4, 0, 9, 2)]
    buffer = SurfaceBuffer()
    for street in streets:
        for number, there in enumerate(moving):
            lit = np.array([number, 7])
            truth = merge_models([street, there])
            truth.faces["lights"][lit] = 1
            joined = buffer.join(street, spheres_of(street), there, lit)
            assert joined["faces"].tobytes() == truth.faces.tobytes()
            assert joined["rounds"].tobytes() == truth.rounds.tobytes()
            assert np.array_equal(joined["corners"], truth.corners)
            assert np.array_equal(joined["spheres"], spheres_of(truth))
        assert not street.faces["lights"].any()
