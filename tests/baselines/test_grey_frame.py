"""The nearest image without its colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.dataset import Dataset
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.submission.writing import write_submission
from mirror.metrics.images.invariant import psnr_invariant
from mirror.protocols.document import Protocol
from mirror.protocols.views import plan_views
from mirror_baselines import grey_frame, nearest_frame

WEIGHTS = np.array([0.299, 0.587, 0.114])


@pytest.mark.parametrize("colour", [(0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255), (12, 200, 99)])
def test_luma_is_rec_601(colour: tuple[int, int, int]) -> None:
    image = np.full((3, 4, 3), colour, np.uint8)
    grey = grey_frame.luma_image(image)
    assert (grey == grey[..., :1]).all()
    assert grey[0, 0, 0] == pytest.approx(WEIGHTS @ colour, abs=0.51)


def test_views_are_the_nearest_images_in_grey(dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    plan = plan_views(dataset, protocol, "novel")
    coloured = {view.path: image for views, image in nearest_frame.render(dataset, plan) for view in views}
    for views, image in grey_frame.render(dataset, plan):
        for view in views:
            assert np.abs(image - (coloured[view.path] @ WEIGHTS)[..., None]).max() <= 0.51
    out = tmp_path / "submission"
    write_submission(dataset, plan, grey_frame.render, grey_frame.METHOD, grey_frame.APPEARANCE, out)
    assert check_submission(open_untrusted(out), plan).problems == ()


def test_grey_gains_nothing_on_the_ranking_metric() -> None:
    """A coloured scene in another light: the render without colours scores lower than the coloured one."""
    rng = np.random.default_rng(3)
    truth = rng.integers(20, 230, (40, 60, 3)).astype(np.uint8)
    render = np.clip(0.8 * truth + 15 + rng.normal(0, 6, truth.shape), 0, 255).astype(np.uint8)
    assert psnr_invariant(grey_frame.luma_image(render), truth) < psnr_invariant(render, truth) - 1.0
