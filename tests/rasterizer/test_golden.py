"""An image that gsplat rendered on CUDA (brush's `tiny_case`: four Gaussians, SH 3)."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.rasterizer import cpu, reference
from hybridworldsim.rasterizer.presets import PRESETS


def _tensors(path: Path) -> dict[str, torch.Tensor]:
    """Read float32 safetensors: a length, a JSON header, the bytes."""
    raw = path.read_bytes()
    begin = 8 + int.from_bytes(raw[:8], "little")
    tensors = {}
    for name, entry in json.loads(raw[8:begin]).items():
        first, last = entry["data_offsets"]
        tensors[name] = torch.from_numpy(
            np.frombuffer(raw[begin + first : begin + last], "<f4").reshape(entry["shape"]).copy()
        )
    return tensors


@pytest.mark.real_data
@pytest.mark.parametrize("backend", [reference, cpu], ids=["reference", "cpu"])
@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_the_golden_case_is_rendered(real_data, preset, backend):
    path = real_data / "brush_golden" / "tiny_case.safetensors"
    if not path.is_file():
        pytest.skip(f"no golden case at {path}")
    case = _tensors(path)
    height, width, _ = case["out_img"].shape
    position = torch.tensor([0.123, 0.456, -8.0])
    viewmat = torch.eye(4)
    viewmat[:3, 3] = -position
    focal = width / 2
    K = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    opacities = case["opacities"].sigmoid()
    seen = backend.project(
        case["means"], case["quats"], case["scales"].exp(), opacities, viewmat, K, width, height, eps2d=0.3,
        near_plane=0.01, far_plane=1e12, radius_clip=0.0, preset=preset, antialiased=False, lens=None,
    )  # fmt: skip
    colours = (backend.spherical_harmonics(3, case["means"] - position, case["coeffs"]) + 0.5).clamp(min=0.0)
    image = backend.blend(
        seen, colours[seen.ids], opacities[seen.ids], width, height, preset=preset, tile_size=16, absgrad=False
    )
    ours = torch.cat([image.image, image.alpha[..., None]], dim=-1)
    assert (ours - case["out_img"]).abs().max() <= 2e-6
