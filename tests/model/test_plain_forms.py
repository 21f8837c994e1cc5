"""Plain torch computes what the compiled kernels compute, with gradients, and keeps to the device of its inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from hybridworldsim.kernels.dispatch import is_compiled, plain_torch
from hybridworldsim.model.decoders import run_mlps
from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.nodes.network_inputs import network_inputs
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.plain.decoding import visible_mask
from hybridworldsim.model.ssim_loss import ssim
from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import to_viewpoint
from tests.model.streets import SOURCES, street, view

FULL = 540, 960
ON = ["meta", pytest.param("cuda", marks=pytest.mark.cuda)]


def both(compute: Callable[[], tuple[list[Tensor], list[Tensor]]]) -> None:
    """Compare values, and gradients as shares of the largest, of the compiled form and of plain torch."""
    values, gradients = compute()
    with plain_torch():
        plain_values, plain_gradients = compute()
    for one, other in zip(values, plain_values, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=2e-5)
    for one, other in zip(gradients, plain_gradients, strict=True):
        scale = float(other.abs().max()) if other.numel() else 0.0
        torch.testing.assert_close(one, other, rtol=0.0, atol=2e-5 * scale + 1e-7)


def test_plain_torch_is_chosen_for_other_devices_and_when_it_is_asked_for() -> None:
    here, elsewhere = torch.zeros(1), torch.zeros(1, device="meta")
    assert is_compiled(here) and not is_compiled(elsewhere)
    with plain_torch():
        assert not is_compiled(here)
    assert is_compiled(here)


@pytest.mark.parametrize("learns", [True, False])
def test_a_street_decodes_and_renders_equally(learns: bool) -> None:
    """Without gradients the compiled form is a fused kernel."""
    one, viewpoint = street(seed=3, k=3, hidden=24), to_viewpoint(view(-25.0), np.zeros(3))
    weights = torch.rand(viewpoint.height_px, viewpoint.width_px, 3, generator=torch.Generator().manual_seed(0))

    def compute() -> tuple[list[Tensor], list[Tensor]]:
        with torch.set_grad_enabled(learns):
            output = one(viewpoint, one.appearance(SOURCES[0]))
            parts = [table for part in output.parts for table in (part.means, part.opacities, part.colours)]
            if not learns:
                return [*parts, output.rgb], []
            leaves = [parameter for parameter in one.parameters() if parameter.requires_grad]
            found = torch.autograd.grad((output.rgb * weights).sum(), leaves, allow_unused=True)
            rows = [part.rows.float() for part in output.parts]
            return [*parts, *rows, output.rgb.detach()], [gradient for gradient in found if gradient is not None]

    both(compute)


@pytest.mark.parametrize("loss", ["structure", "normal"])
def test_losses_are_equal(loss: str) -> None:
    generator = torch.Generator().manual_seed(1)
    known = torch.rand(40, 60, generator=generator) < 0.97
    viewpoint = to_viewpoint(view(), np.zeros(3))

    def compute() -> tuple[list[Tensor], list[Tensor]]:
        generator = torch.Generator().manual_seed(2)
        if loss == "structure":
            given = torch.rand(40, 60, 3, generator=generator).requires_grad_()
            value = structure_loss(given, torch.rand(40, 60, 3, generator=generator), known)
        else:
            given = (5.0 + torch.rand(40, 60, generator=generator)).requires_grad_()
            value = normal_loss(given, 5.0 + torch.rand(40, 60, generator=generator), known, viewpoint.K)
        (gradient,) = torch.autograd.grad(value, given)
        return [value.detach()], [gradient]

    both(compute)


def test_visible_rows_are_equal() -> None:
    generator = torch.Generator().manual_seed(0)
    means, reach = 100.0 * (torch.rand(5000, 3, generator=generator) - 0.5), torch.rand(5000, generator=generator)
    for place in (view(), view(-60.0, fx_px=400.0), view(3.0, 3.0, 30.0, fx_px=10.0)):
        viewpoint = to_viewpoint(place, np.zeros(3))
        compiled = select_visible(viewpoint, means, reach)
        with plain_torch():
            plain = select_visible(viewpoint, means, reach)
        # A sphere that touches a plane may be on either side, by rounding.
        assert len(np.setxor1d(compiled.numpy(), plain.numpy())) <= 1 and 0 < len(plain) < 5000


@pytest.mark.parametrize("device", ON)
def test_parts_with_fixed_shapes_compute_at_full_size_on_any_device(device: str) -> None:
    """Three million rows, and images of 960 x 540: what mixes devices is refused on the meta device too."""
    if device == "cuda" and torch.cuda.mem_get_info()[0] < 16 << 30:
        pytest.skip("16 GiB of memory of the GPU are not free")
    rows, viewpoint = 3_000_000, to_viewpoint(view(), np.zeros(3))
    one = street(seed=1, k=3).to(device)
    means = torch.zeros(rows, 3, device=device)
    assert visible_mask(viewpoint, means, torch.ones(rows, device=device)).shape == (rows,)
    codes = torch.zeros(rows, 32, device=device, requires_grad=True)
    inputs = network_inputs(codes, means, viewpoint.centre, 75.0)
    latent = one.appearance(SOURCES[0])
    geometry, colours = run_mlps(inputs, (one.background.geometry, latent), (one.background.colour, latent))
    (geometry.sum() + colours.sum()).backward()
    assert codes.grad is not None and codes.grad.shape == (rows, 32) and codes.grad.device.type == device
    rgb, recorded = (torch.zeros(*FULL, 3, device=device) for _ in range(2))
    depth_m, scored = torch.ones(FULL, device=device), torch.ones(FULL, dtype=torch.bool, device=device)
    for given, value in (
        (rgb.requires_grad_(), lambda: colour_loss(rgb, recorded, scored) + structure_loss(rgb, recorded, scored)),
        (rgb, lambda: ssim(rgb, recorded).sum()),
        (depth_m.requires_grad_(), lambda: depth_loss(depth_m, depth_m.detach(), scored)),
        (depth_m, lambda: normal_loss(depth_m, depth_m.detach(), scored, viewpoint.K)),
    ):
        (gradient,) = torch.autograd.grad(value(), given)
        assert gradient.shape == given.shape and gradient.device.type == device
