"""Redacted pixels are neither scored nor used by multi-view stereo."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mirror
from hybridworldsim.mvs.images.posed_images import PosedImage, find_static_pixels
from mirror.dataset.splits import make_split
from mirror.protocols.document import parse_protocol
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import plan_views
from mirror.schema.documents import NovelTraversal
from tests.evaluation.submissions import small_text


def test_redacted_pixels_are_left_out(dataset: Path) -> None:
    make_split(dataset, "novel", NovelTraversal(train=1, held_out=1), seed=0)
    view = mirror.open(str(dataset))
    text = small_text(every=1, width=128, space="raw").replace('dynamic = ["boxes"]', "dynamic = []")
    protocol = parse_protocol(text.replace('"front_left"', '"rear_left"').encode(), "test")
    plan = plan_views(view, protocol, "novel")
    (layers,) = {plan.layers[one.traversal_id] for one in plan.views}
    assert layers == ("redaction:masks/deidentify@1",)
    truth = GroundTruth(view, protocol, plan.layers)
    counts = {"front_wide": 0, "rear_left": 0}
    for one in plan.views:
        frame, image = truth.recorded_frame_and_image(one)
        masks = [mask.decode() > 0 for mask in image.masks() if mask.kind == "redaction"]
        expected = ~masks[0] if masks else np.ones((72, 128), np.bool_)
        assert np.array_equal(truth.scored_mask(one), expected)
        posed = PosedImage("a", one.traversal_id, "day", frame, image, one.lens, image.world_SE3_camera)
        assert np.array_equal(find_static_pixels(posed, protocol.pixels), expected)
        counts[image.camera] += int((~expected).sum())
    assert counts["front_wide"] > 0 and counts["rear_left"] == 0
