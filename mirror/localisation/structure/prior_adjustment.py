"""A bundle adjustment of a map that also heeds the fixes of a track, so that long drives do not drift from them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, Int64

_LOSS_SIGMA: Final = 2.0
_WORST_SIGMA_M: Final = 1e4


def adjust_to_track(reconstruction: Any, used: Int64, positions: Float64, sigma_m: Float64) -> None:
    """Adjust poses and points of a reconstruction that lies in the frame of the track already.

    Args:
        reconstruction: pycolmap's, one camera; it is changed.
        used: (F,) numbers of its images that a fix belongs to.
        positions: (F, 3) positions of the camera by the track.
        sigma_m: (F,) 1-sigma of them along each horizontal axis; heights have twice of it, NaN heights none.
    """
    import pycolmap

    by_number = {int(one.name): one for one in reconstruction.images.values()}
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    config = pycolmap.BundleAdjustmentConfig()
    for image in by_number.values():
        if image.has_pose:
            config.add_image(image.image_id)
    priors = []
    for number, position, sigma in zip(used.tolist(), positions, sigma_m.tolist()):
        image = by_number[number]
        height = 2.0 * sigma if np.isfinite(position[2]) else _WORST_SIGMA_M
        prior = pycolmap.PosePrior()
        prior.pose_prior_id = image.image_id
        prior.corr_data_id = image.data_id
        prior.position = np.where(np.isfinite(position), position, image.projection_center())
        prior.position_covariance = np.diag([sigma**2, sigma**2, height**2])
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
    prior_options.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    prior_options.ceres.prior_position_loss_scale = _LOSS_SIGMA
    prior_options.alignment_ransac.random_seed = 0
    pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, reconstruction).solve()
