"""``python -m benchmarks.plates.training.export WEIGHTS OUT``: writes the network as ONNX, with boxes in pixels."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.plates.training.network import Decoded, PlateNetwork
from mirror.weights.resolve import file_sha256

_OPSET = 17
_TOLERANCE_PX = 1e-2


def export(weights: Path, out: Path) -> float:
    """Write the network as ONNX, and return how far its outputs are from those of the network, in pixels.

    Args:
        weights: ``plates.pt`` of the training.
        out: the file that is written. Its input ``images`` is (1, 3, H, W), RGB, 0 to 255, sides that are multiples
            of 64; its output ``boxes`` is (1, N, 5): left, top, right, bottom, score.
    """
    import onnxruntime

    network = PlateNetwork()
    network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    decoded = Decoded(network).eval()
    axes = {"images": {2: "height", 3: "width"}, "boxes": {1: "cells"}}
    torch.onnx.export(
        decoded, (torch.zeros(1, 3, 256, 320),), str(out), dynamo=False, opset_version=_OPSET,
        input_names=["images"], output_names=["boxes"], dynamic_axes=axes,
    )  # fmt: skip
    session = onnxruntime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    # A size that differs from the traced one shows that the cells follow the image.
    images = np.random.default_rng(0).integers(0, 256, (1, 3, 448, 640)).astype(np.float32)
    with torch.inference_mode():
        expected = decoded(torch.from_numpy(images)).numpy()
    return float(np.abs(session.run(None, {"images": images})[0] - expected).max())


def main(argv: Sequence[str]) -> int:
    weights, out = map(Path, argv)
    error = export(weights, out)
    print(f"{out}: {out.stat().st_size} bytes, sha256 {file_sha256(out)}, largest difference {error:.2e} px")
    return int(not error < _TOLERANCE_PX)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
