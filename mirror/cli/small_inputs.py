"""Calls with small inputs of compiled functions that the verbs of `mirror compile` do not reach on its tiny street.

``python -m mirror.cli.small_inputs`` makes them; a package with methods may have a module ``small_inputs`` too.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from mirror.compiled import machine_code_only


def main() -> None:
    """Call the functions."""
    with machine_code_only():
        _compare_images()
        _compare_boxes()
        _inspect_an_image()
        _adjust_a_rig()
        if find_spec("scipy") is not None:
            # Its LAPACK solves the equations of tracks.
            _refine_tracks()


def _compare_images() -> None:
    from mirror.metrics import ssim

    images = np.random.default_rng(0).integers(0, 256, (2, 24, 24, 3), np.uint8)
    mask = np.ones((24, 24), bool)
    mask[0] = False
    for precision in ("float64", "float32"):
        ssim(images[0].astype(np.float32), images[1].astype(np.float32), data_range=255.0, precision=precision)
        for chosen in (None, mask):
            ssim(images[0], images[1], mask=chosen, precision=precision)
            ssim(images[0] / 255.0, images[1] / 255.0, mask=chosen, data_range=1.0, precision=precision)


def _compare_boxes() -> None:
    from mirror.geometry import Poses
    from mirror.metrics.boxes import box_iou_3d
    from mirror.metrics.detection.matching import MatchingTable

    pose, one = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3))), np.zeros(1, np.int64)
    box_iou_3d(pose, np.full((1, 3), 2.0), pose, np.ones((1, 3)))
    MatchingTable(one, 1, np.array([0, 1]), one, np.zeros(1)).assign(np.ones(1), 1)


def _inspect_an_image() -> None:
    import cv2

    from mirror.dataset.images.metadata import list_metadata

    pixels = np.random.default_rng(0).integers(0, 256, (16, 16, 3), np.uint8)
    list_metadata(cv2.imencode(".jpg", pixels)[1].tobytes(), "image.jpg")


def _refine_tracks() -> None:
    from mirror.calibration.affine import refine_tracks

    image = np.random.default_rng(0).uniform(0.0, 255.0, (64, 64)).astype(np.float32)
    refine_tracks(image, image, np.full((1, 2), 32.0), np.full((1, 2), 32.0))


def _adjust_a_rig() -> None:
    """Two points, each in the images of one camera in two frames."""
    from mirror.calibration.refinement.equations import MOUNT, POSE, reduce_equations, residuals_px, step_points

    starts, image, zeros = np.array([0, 2, 4]), np.array([0, 1, 0, 1]), np.zeros(2, np.int64)
    seen = (np.tile([1.0, 0.0, 0.0], (4, 1)), np.ones((4, 2, 3)), np.zeros((4, 2)), np.zeros((4, 2, 0)))
    turns, places = np.stack([np.eye(3)] * 2), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    none, points = np.zeros((1, 3)), np.array([[5.0, 0.0, 0.0], [5.0, 1.0, 0.0]])
    model = (turns, places, turns[:1], places[:1], none, none, points)
    numbers = (image, np.array([0, 1]), zeros)
    residuals_px(*numbers, *seen, np.array([0, 0, 1, 1]), *model)
    *_, inverses, mixed, slopes = reduce_equations(starts, *numbers, *seen, np.ones(4), *model, 2, 1.0)
    step_points(starts, *numbers, inverses, mixed, slopes, np.zeros(2 * POSE + MOUNT), 2, 1)


if __name__ == "__main__":
    main()
