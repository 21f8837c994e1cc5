"""The seven points of a Gaussian in the unscented transform: places, moments, and the gradients to the spread.

The scratch array of a kernel holds, at the offsets below, the steps along the axes, the pixels of the points, the
gradients to them, the slopes of the pixels, and what a rolling shutter adds.
"""

from __future__ import annotations

from typing import Any, Final

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import dot, row_times_matrix
from hybridworldsim.rasterizer.cpu.projection.gradients import add, combine, multiply_by, quaternion_gradient
from hybridworldsim.rasterizer.lenses import UT_ALPHA, UT_BETA, UT_SPREAD

WEIGHT: Final = 0.5 / UT_SPREAD**2
OUTER: Final = UT_BETA - UT_ALPHA**2
PIXELS: Final = 72  # offset in the scratch, after the axes: x and y of seven points
POINTS: Final = 184  # offset after the pixels: seven gradients in the camera frame
SLOPES: Final = 352  # offset after the gradients: slopes of x and y of each point
MOTION: Final = 688  # offset after the slopes: what a rolling shutter keeps of the points
SCRATCH: Final = 992
"""Size of a kernel's float64 scratch array."""


@kernel(inline="always")
def axes_in_camera(camera: Any, first: Any, second: Any, third: Any) -> Any:
    """Compute the rows of the rotation from a Gaussian to the camera; its columns are the Gaussian's axes."""
    return (
        row_times_matrix((camera.r00, camera.r01, camera.r02), first, second, third),
        row_times_matrix((camera.r10, camera.r11, camera.r12), first, second, third),
        row_times_matrix((camera.r20, camera.r21, camera.r22), first, second, third),
    )


@kernel(inline="always")
def store_steps(axes: Any, scale: Any, scratch: Any) -> None:
    """Store the steps from the mean to the points, axis by axis."""
    lanes.store(scratch, 0, UT_SPREAD * scale[0] * axes[0][0])
    lanes.store(scratch, 8, UT_SPREAD * scale[0] * axes[1][0])
    lanes.store(scratch, 16, UT_SPREAD * scale[0] * axes[2][0])
    lanes.store(scratch, 24, UT_SPREAD * scale[1] * axes[0][1])
    lanes.store(scratch, 32, UT_SPREAD * scale[1] * axes[1][1])
    lanes.store(scratch, 40, UT_SPREAD * scale[1] * axes[2][1])
    lanes.store(scratch, 48, UT_SPREAD * scale[2] * axes[0][2])
    lanes.store(scratch, 56, UT_SPREAD * scale[2] * axes[1][2])
    lanes.store(scratch, 64, UT_SPREAD * scale[2] * axes[2][2])


@kernel(inline="always")
def sigma_point(number: Any, mean: Any, scratch: Any) -> Any:
    """Compute one of the seven points: 0 is the mean, 1 to 3 lie at positive, 4 to 6 at negative steps."""
    sign = 0.0 if number == 0 else (1.0 if number < 4 else -1.0)
    axis = 24 * ((number + 2) % 3)
    return (
        mean[0] + sign * lanes.load(scratch, axis),
        mean[1] + sign * lanes.load(scratch, axis + 8),
        mean[2] + sign * lanes.load(scratch, axis + 16),
    )


@kernel(inline="always")
def moments(scratch: Any) -> Any:
    """Compute the shift of the mean, and xx, xy, yy and the determinant of the covariance, from the points' pixels.

    The function replaces the pixels of points 1 to 6 by their offsets d.
    """
    centre_x, centre_y = lanes.load(scratch, PIXELS), lanes.load(scratch, PIXELS + 8)
    zero = lanes.broadcast(0.0)
    shift_x, shift_y, xx, xy, yy, sharp, across = zero, zero, zero, zero, zero, zero, zero
    for number in range(1, 7):
        at = PIXELS + 16 * number
        x, y = lanes.load(scratch, at) - centre_x, lanes.load(scratch, at + 8) - centre_y
        lanes.store(scratch, at, x)
        lanes.store(scratch, at + 8, y)
        shift_x, shift_y = shift_x + WEIGHT * x, shift_y + WEIGHT * y
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
    # the determinant as a sum of squared minors (Cauchy-Binet), which is exact for needles
    for number in range(1, 7):
        at = PIXELS + 16 * number
        x, y = lanes.load(scratch, at), lanes.load(scratch, at + 8)
        minor = x * shift_y - y * shift_x
        across = across + minor * minor
        for other in range(1, number):
            minor = x * lanes.load(scratch, PIXELS + 16 * other + 8) - y * lanes.load(scratch, PIXELS + 16 * other)
            sharp = sharp + minor * minor
    return (
        (shift_x, shift_y),
        (
            WEIGHT * xx + OUTER * shift_x * shift_x,
            WEIGHT * xy + OUTER * shift_x * shift_y,
            WEIGHT * yy + OUTER * shift_y * shift_y,
            WEIGHT * WEIGHT * sharp + WEIGHT * OUTER * across,
        ),
    )


@kernel(inline="always")
def _step_gradient(coordinate: Any, scratch: Any) -> Any:
    """Compute the gradient to one coordinate of the three axes, which have a length of one standard deviation."""
    return (
        UT_SPREAD * (lanes.load(scratch, POINTS + 24 + coordinate) - lanes.load(scratch, POINTS + 96 + coordinate)),
        UT_SPREAD * (lanes.load(scratch, POINTS + 48 + coordinate) - lanes.load(scratch, POINTS + 120 + coordinate)),
        UT_SPREAD * (lanes.load(scratch, POINTS + 72 + coordinate) - lanes.load(scratch, POINTS + 144 + coordinate)),
    )


@kernel(inline="always")
def spread_gradient(
    camera: Any,
    quat: Any,
    k: Any,
    scale: Any,
    axes: Any,
    first: Any,
    second: Any,
    third: Any,
    grad_mean_camera: Any,
    world: Any,
    scratch: Any,
) -> Any:
    """Compute the gradients to quaternion and scales, and to the rows of the view's rotation, from those to the points.

    Args:
        camera: `KernelCamera`.
        quat: four lanes.
        k: 2 / squared norm of the quaternion.
        scale: three lanes.
        axes: rows of the rotation from the Gaussian to the camera.
        first: first row of the Gaussian's rotation.
        second: second row.
        third: third row.
        grad_mean_camera: gradient to the mean in the camera frame.
        world: the mean.
        scratch: the gradients to the points.
    """
    along_x, along_y, along_z = _step_gradient(0, scratch), _step_gradient(8, scratch), _step_gradient(16, scratch)
    grad_scale = (
        along_x[0] * axes[0][0] + along_y[0] * axes[1][0] + along_z[0] * axes[2][0],
        along_x[1] * axes[0][1] + along_y[1] * axes[1][1] + along_z[1] * axes[2][1],
        along_x[2] * axes[0][2] + along_y[2] * axes[1][2] + along_z[2] * axes[2][2],
    )
    grad_x = (along_x[0] * scale[0], along_x[1] * scale[1], along_x[2] * scale[2])
    grad_y = (along_y[0] * scale[0], along_y[1] * scale[1], along_y[2] * scale[2])
    grad_z = (along_z[0] * scale[0], along_z[1] * scale[1], along_z[2] * scale[2])
    grad_quat = quaternion_gradient(
        quat,
        k,
        add(combine(camera.r00, grad_x, camera.r10, grad_y), multiply_by(camera.r20, grad_z)),
        add(combine(camera.r01, grad_x, camera.r11, grad_y), multiply_by(camera.r21, grad_z)),
        add(combine(camera.r02, grad_x, camera.r12, grad_y), multiply_by(camera.r22, grad_z)),
    )
    return (
        grad_quat,
        grad_scale,
        add((dot(grad_x, first), dot(grad_x, second), dot(grad_x, third)), multiply_by(grad_mean_camera[0], world)),
        add((dot(grad_y, first), dot(grad_y, second), dot(grad_y, third)), multiply_by(grad_mean_camera[1], world)),
        add((dot(grad_z, first), dot(grad_z, second), dot(grad_z, third)), multiply_by(grad_mean_camera[2], world)),
    )


@kernel(inline="always")
def put_triple(scratch: Any, at: Any, triple: Any) -> None:
    """Store a triple of lanes in the scratch."""
    lanes.store(scratch, at, triple[0])
    lanes.store(scratch, at + 8, triple[1])
    lanes.store(scratch, at + 16, triple[2])


@kernel(inline="always")
def get_triple(scratch: Any, at: Any) -> Any:
    """Load a triple of lanes from the scratch."""
    return lanes.load(scratch, at), lanes.load(scratch, at + 8), lanes.load(scratch, at + 16)
