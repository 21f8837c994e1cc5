"""The learned estimators compute where their inputs are: at full size on the meta device, which has no memory."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from hybridworldsim.mvs.learned.images import SourceImage
from hybridworldsim.mvs.learned.layers import fold_norms
from hybridworldsim.mvs.learned.warping import SampleMotion
from hybridworldsim.mvs.mvsnet.network import FEATURE_STRIDE, MVSNet
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes
from hybridworldsim.mvs.mvsnet.upsampling import repeat_samples, upsample_depth
from hybridworldsim.mvs.patchmatchnet.network import PatchmatchNet

HEIGHT, WIDTH, SOURCES = 256, 448, 6


def sources(device: str, strides: tuple[int, ...]) -> list[SourceImage]:
    """Sources of full size, partly hidden."""
    motion = SampleMotion(np.eye(3), np.array([0.5, 0.0, 0.1]))
    hidden = {stride: torch.ones(HEIGHT // stride, WIDTH // stride, device=device) for stride in strides}
    rgb = torch.ones(3, HEIGHT, WIDTH, device=device)
    return [SourceImage(rgb, dict.fromkeys(strides, motion), hidden) for _ in range(SOURCES)]


@pytest.mark.parametrize("device", ["meta", pytest.param("cuda", marks=pytest.mark.cuda)])
@pytest.mark.parametrize("name", ["mvsnet", "patchmatchnet"])
@torch.inference_mode()
def test_a_network_computes_where_its_images_are(name: str, device: str) -> None:
    network: nn.Module = MVSNet(refine=True) if name == "mvsnet" else PatchmatchNet()
    fold_norms(network)
    network.to(device)
    rgb = torch.ones(3, HEIGHT, WIDTH, device=device)
    if name == "mvsnet":
        planes = DepthPlanes(2.0, 200.0, 192, "inverse_depth")
        coarse, sure = network(rgb, sources(device, (FEATURE_STRIDE,)), planes)
        depth_m, confidence = upsample_depth(coarse, FEATURE_STRIDE), repeat_samples(sure, FEATURE_STRIDE)
    else:
        generator = torch.Generator().manual_seed(0)
        depth_m, confidence = network(rgb, sources(device, (2, 4, 8)), 2.0, 200.0, generator)
    for result in (depth_m, confidence):
        assert result.shape == (HEIGHT, WIDTH) and result.device.type == device
