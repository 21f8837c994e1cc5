"""What a camera makes of radiance: blur, drops, glare, exposure, film, noise; it takes numba and OpenCV with it."""

from __future__ import annotations

from mirror.synth.render.develop.developing import develop
from mirror.synth.render.develop.drops import lens_drops
from mirror.synth.render.develop.exposing import exposure_of
from mirror.synth.render.develop.look import CameraLook, camera_look
from mirror.synth.render.develop.motion import ImageJacobian, image_jacobian, image_motion

__all__ = [
    "CameraLook",
    "ImageJacobian",
    "camera_look",
    "develop",
    "exposure_of",
    "image_jacobian",
    "image_motion",
    "lens_drops",
]
