"""The camera model, from radiance to 8-bit images: blur, drops, glare, exposure, tone curve, noise. Imports numba."""

from __future__ import annotations

from mirror.synth.render.develop.camera_response import CameraResponse, draw_camera_response
from mirror.synth.render.develop.developing import develop
from mirror.synth.render.develop.drops import draw_lens_drops
from mirror.synth.render.develop.exposure import compute_exposure
from mirror.synth.render.develop.motion import ImageJacobian, compute_image_jacobian, compute_image_motion

__all__ = [
    "CameraResponse",
    "ImageJacobian",
    "compute_exposure",
    "compute_image_jacobian",
    "compute_image_motion",
    "develop",
    "draw_camera_response",
    "draw_lens_drops",
]
