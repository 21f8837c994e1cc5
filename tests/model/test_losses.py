import math

import pytest
import torch
from skimage.metrics import structural_similarity
from torch.nn import functional

from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.plain.losses import compute_normals, curvature
from hybridworldsim.model.plain.losses import normal_loss as plain_normal_loss

K = torch.tensor([[60.0, 0.0, 32.0], [0.0, 55.0, 24.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def plane(normal, distance, height=48, width=64):
    """Depth (H, W) of the plane n . p = d."""
    x = (torch.arange(width, dtype=torch.float64) + 0.5 - K[0, 2]) / K[0, 0]
    y = (torch.arange(height, dtype=torch.float64) + 0.5 - K[1, 2]) / K[1, 1]
    return distance / (normal[0] * x[None] + normal[1] * y[:, None] + normal[2])


def test_colour_loss_is_the_mean_square_of_scored_pixels():
    rendered, recorded = torch.rand(5, 7, 3), torch.rand(5, 7, 3)
    scored = torch.zeros(5, 7, dtype=torch.bool)
    scored[1:3, 2:6] = True
    expected = (rendered - recorded)[scored].square().mean()
    torch.testing.assert_close(colour_loss(rendered, recorded, scored), expected)


def test_unscored_pixels_have_no_gradient():
    rendered = torch.rand(4, 4, 3, requires_grad=True)
    scored = torch.eye(4, dtype=torch.bool)
    colour_loss(rendered, torch.zeros(4, 4, 3), scored).backward()
    assert not rendered.grad[~scored].any()
    assert rendered.grad[scored].all()


def test_structure_loss_treats_unscored_pixels_as_exact():
    torch.manual_seed(0)
    recorded = torch.rand(30, 40, 3)
    scored = torch.zeros(30, 40, dtype=torch.bool)
    scored[8:22, 5:30] = True
    rendered = (recorded + 0.2 * torch.randn(30, 40, 3)).requires_grad_()
    loss = structure_loss(rendered, recorded, scored)
    elsewhere = torch.where(scored[..., None], rendered.detach(), torch.rand(30, 40, 3))
    torch.testing.assert_close(structure_loss(elsewhere, recorded, scored), loss.detach())
    filled = torch.where(scored[..., None], rendered.detach(), recorded).numpy()
    _, map_ = structural_similarity(
        filled, recorded.numpy(), channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    # Inside the border, where windows lie within the image.
    torch.testing.assert_close(loss.item(), 1.0 - float(map_.mean(2)[scored.numpy()].mean()), rtol=1e-3, atol=1e-4)
    loss.backward()
    assert not rendered.grad[~scored].any() and rendered.grad[scored].any()
    assert structure_loss(recorded, recorded, scored).abs() < 1e-5
    assert structure_loss(recorded, recorded, torch.zeros_like(scored)) == 1.0


def test_depth_errors_are_shares_limited_to_one():
    stereo = torch.tensor([[10.0, 10.0, 10.0, 0.0]])
    rendered = torch.tensor([[11.0, 9.0, 1e6, 5.0]])
    assert depth_loss(rendered, stereo, stereo > 0) == pytest.approx((0.01 + 0.01 + 1.0) / 3)


def test_unknown_depth_has_no_loss():
    depth = torch.rand(6, 6, requires_grad=True)
    none = torch.zeros(6, 6, dtype=torch.bool)
    loss = depth_loss(depth, torch.zeros(6, 6), none) + normal_loss(depth, torch.zeros(6, 6), none, K.float())
    loss.backward()
    assert loss == 0.0
    assert not depth.grad.any()


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, -0.2, 0.9), (0.0, 0.9, 0.4)])
def test_plane_has_its_normal_and_no_curvature(normal):
    unit = torch.tensor(normal, dtype=torch.float64)
    unit = unit / unit.norm()
    depth = plane(unit, 8.0, height=20)
    result = compute_normals(depth, K)
    inner = result[1:-1, 1:-1]
    torch.testing.assert_close(inner, (-unit).expand_as(inner), atol=1e-9, rtol=0.0)
    assert curvature(inner).abs().max() < 1e-15


def test_curvature_matches_sobel_convolutions():
    normals = torch.randn(9, 11, 3, dtype=torch.float64)
    x = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]], dtype=torch.float64)
    kernels = torch.stack((x, x.T))[:, None]
    expected = functional.conv2d(normals.permute(2, 0, 1)[:, None], kernels).square().sum((0, 1))
    torch.testing.assert_close(curvature(normals), expected)


def test_normals_of_a_sphere_point_from_its_centre():
    radius, far = 2.0, 10.0
    x = (torch.arange(64, dtype=torch.float64) + 0.5 - K[0, 2]) / K[0, 0]
    y = (torch.arange(48, dtype=torch.float64) + 0.5 - K[1, 2]) / K[1, 1]
    square = x[None] ** 2 + y[:, None] ** 2 + 1.0
    # |t ray - centre| = radius
    root = far**2 - square * (far**2 - radius**2)
    hit = root > 0.2
    depth = torch.where(hit, (far - root.clamp_min(0).sqrt()) / square, 1.0)
    points = torch.stack((x * depth, y[:, None] * depth, depth), 2)
    points[..., 2] -= far
    result = compute_normals(depth, K)
    inside = -functional.max_pool2d(-hit[None].double(), 3, 1, 1)[0] > 0.5
    angles = torch.rad2deg(torch.arccos((result * points / radius).sum(2).clamp(-1, 1)))
    assert inside.sum() > 50
    assert angles[inside].max() < 3.0


def test_equal_depths_have_no_normal_loss_and_a_step_has():
    flat = torch.full((20, 20), 5.0)
    known = torch.ones(20, 20, dtype=torch.bool)
    step = flat.clone()
    step[:, 10:] = 7.0
    assert normal_loss(flat, flat, known, K.float()) < 1e-9
    assert normal_loss(step, flat, known, K.float()) > 1e-3
    assert math.isfinite(float(normal_loss(torch.zeros(20, 20), flat, known, K.float())))


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (9, 1), (3, 3)])
def test_tiny_images_have_a_finite_normal_loss(shape: tuple[int, int]) -> None:
    depth = torch.full(shape, 5.0, requires_grad=True)
    K = torch.tensor([[40.0, 0.0, 2.0], [0.0, 40.0, 2.0], [0.0, 0.0, 1.0]])
    loss = normal_loss(depth, torch.full(shape, 6.0), torch.ones(shape, dtype=torch.bool), K)
    loss.backward()
    assert torch.isfinite(loss) and torch.isfinite(depth.grad).all()
    assert min(shape) > 2 or loss == 0.0


@pytest.mark.parametrize("shape", [(9, 11), (5, 5), (24, 3), (40, 60)])
@pytest.mark.parametrize("share", [1.0, 0.98, 0.7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normal_loss_matches_plain_torch(shape, share, dtype):
    generator = torch.Generator().manual_seed(shape[0])
    depth = 5.0 + torch.rand(shape, generator=generator, dtype=torch.float64)
    depth[0, 0] = 0.0
    stereo = depth + 0.1 * torch.rand(shape, generator=generator, dtype=torch.float64)
    stereo[1, 1] = 0.0
    known = torch.rand(shape, generator=generator) < share
    known[1, 1] = False
    exact = depth.clone().requires_grad_()
    expected = plain_normal_loss(exact, stereo, known, K)
    (3.0 * expected).backward()
    given = depth.to(dtype).requires_grad_()
    result = normal_loss(given, stereo.to(dtype), known, K.to(dtype))
    (3.0 * result).backward()
    assert result.dtype == given.grad.dtype == dtype
    rough = 1e-4 if dtype == torch.float32 else 1e-9
    torch.testing.assert_close(result.double(), expected, rtol=rough, atol=rough)
    scale = float(exact.grad.abs().max())
    torch.testing.assert_close(given.grad.double(), exact.grad, rtol=0.0, atol=rough * scale + 1e-12)


def test_border_depths_get_gradients():
    generator = torch.Generator().manual_seed(1)
    depth = (5.0 + torch.rand(6, 7, generator=generator)).requires_grad_()
    normal_loss(depth, torch.full((6, 7), 5.0), torch.ones(6, 7, dtype=torch.bool), K.float()).backward()
    assert depth.grad[0].any() and depth.grad[:, -1].any()
