"""Exports a network to ONNX: inputs ``images`` and ``points``, outputs ``logits`` and ``codes`` of the last layer."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from hybridworldsim.petr.detector import LastLayer
from mirror.errors import UsageError
from mirror.installation import install_command


def export_onnx(network: nn.Module, images: Tensor, points: Tensor, path: Path) -> None:
    """Write an ONNX file for inputs of given shapes.

    Args:
        network: `hybridworldsim.petr.detector.Petr` or a network of the same interface, in float32.
        images: (B, N, 3, H, W) example.
        points: (B, N, h, w, D, 3) example.
        path: the file.

    Raises:
        UsageError: the package onnx is not installed.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        torch.onnx.export(
            LastLayer(network).eval(),
            (images, points),
            str(temporary),
            input_names=["images", "points"],
            output_names=["logits", "codes"],
            dynamo=True,
            external_data=False,
            verbose=False,
        )
        temporary.replace(path)
    except ModuleNotFoundError as error:
        raise UsageError(f"the export needs {error.name}", remedy=install_command("onnx")) from error
    finally:
        temporary.unlink(missing_ok=True)
