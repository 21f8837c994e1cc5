"""The floors that say little: the mean image of a camera, and the smoothed nearest image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.views import plan_views
from mirror_baselines import camera_mean, smoothed_nearest_frame


def test_camera_mean_averages_the_rendered_training_images(dataset: Dataset, protocol: Protocol) -> None:
    plan = plan_views(dataset, protocol, "novel")
    for views, image in camera_mean.render(dataset, plan):
        assert len({(view.scene_id, view.camera, view.width_px, view.height_px) for view in views}) == 1
        listed = camera_mean.list_training_images(dataset, plan)[views[0].scene_id, views[0].camera].images
        chosen = [listed[place] for place in np.linspace(0, len(listed) - 1, min(len(listed), 40)).round().astype(int)]
        size = (views[0].width_px, views[0].height_px)
        finals = [
            camera_mean.cached_raster(one.camera_model, protocol.pixels).to_final(one.decode()).astype(float)
            for one in chosen
        ]
        resized = [one if one.shape[1::-1] == size else cv2.resize(one, size, interpolation=3) for one in finals]
        assert np.abs(image - np.mean(resized, axis=0)).max() <= 1.0


def test_smoothing_keeps_flat_images_and_removes_detail() -> None:
    flat = np.full((40, 60, 3), (12, 200, 99), np.uint8)
    assert np.abs(smoothed_nearest_frame.smooth_image(flat, 6.0, 30.0).astype(int) - flat).max() <= 1
    board = (np.indices((40, 60)).sum(axis=0) % 2 * 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    assert smoothed_nearest_frame.smooth_image(board, 6.0, 30.0).std() < 3.0


@pytest.mark.parametrize("method", ["camera_mean", "smoothed_nearest_frame"])
def test_floors_are_valid_submissions(dataset: Dataset, tmp_path: Path, method: str) -> None:
    out = tmp_path / "floor"
    assert main(["baseline", str(dataset.root), "--method", method, "--split", "novel", "--out", str(out)]) == 0
    plan = plan_views(dataset, load_protocol("static-reconstruction"), "novel")
    assert check_submission(open_untrusted(out), plan).problems == ()
