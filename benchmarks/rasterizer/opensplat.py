"""OpenSplat's CPU rasterizer as a peer: a program outside the repository, named by ``MIRROR_OPENSPLAT``.

OpenSplat is AGPL, so neither it nor the program is in this repository. The program is called with
``INPUT OUTPUT REPEATS THREADS`` and prints the median milliseconds of projection, blending, blending's backward and
projection's backward. ``INPUT`` is int32 count, width, height, then float32 fx, fy, cx, cy, viewmat (4, 4), means,
quats, scales, opacities, colours, and the gradient of the image (height, width, 3); ``OUTPUT`` is float32 image,
then the gradients of means, quats, scales, opacities and colours.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.rasterizer.scenes import Splats
from mirror.arrays import Float32

VARIABLE = "MIRROR_OPENSPLAT"


@dataclass(frozen=True)
class OpenSplatResult:
    """OpenSplat's image, gradients and times.

    Attributes:
        project_ms: projection of all Gaussians.
        blend_ms: sorting and blending.
        blend_back_ms: backward pass of blending.
        project_back_ms: backward pass of projection.
        image: (height, width, 3).
        gradients: by tensor.
    """

    project_ms: float
    blend_ms: float
    blend_back_ms: float
    project_back_ms: float
    image: Float32
    gradients: dict[str, Float32]

    @property
    def forward_ms(self) -> float:
        """Time of projection and blending."""
        return self.project_ms + self.blend_ms

    @property
    def backward_ms(self) -> float:
        """Time of the gradients of both."""
        return self.project_back_ms + self.blend_back_ms


def find_program() -> Path | None:
    """Return the path of the program, or None if it is not configured."""
    named = os.environ.get(VARIABLE)
    return Path(named) if named else None


def run(path: Path, scene: Splats, weight: Float32, repeats: int = 3, threads: int = 1) -> OpenSplatResult:
    """Render a scene and compute its gradients.

    Args:
        path: the program.
        scene: Gaussians and camera.
        weight: (height, width, 3), the gradient of the image.
        repeats: number of timed calls.
        threads: number of threads of its projection; its blending uses one.
    """
    height, width, _ = weight.shape
    camera = scene.camera_matrix(width, height)
    arrays = (scene.means, scene.quats, scene.scales, scene.opacities, scene.colors)
    with tempfile.TemporaryDirectory() as folder:
        input_file, output_file = Path(folder) / "in", Path(folder) / "out"
        with input_file.open("wb") as file:
            file.write(np.array([len(scene), width, height], np.int32).tobytes())
            floats = (camera[[0, 1, 0, 1], [0, 1, 2, 2]], scene.viewmat, *arrays, weight)
            file.writelines(np.ascontiguousarray(part, np.float32).tobytes() for part in floats)
        command = [str(path), str(input_file), str(output_file), str(repeats), str(threads)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        values = np.fromfile(output_file, np.float32)
    names = ("means", "quats", "scales", "opacities", "colors")
    sizes = np.cumsum([weight.size, *(array.size for array in arrays)])
    image, *gradients = np.split(values, sizes[:-1])
    shaped = {name: part.reshape(array.shape) for name, part, array in zip(names, gradients, arrays)}
    project, blend, blend_back, project_back = map(float, printed.split())
    return OpenSplatResult(project, blend, blend_back, project_back, image.reshape(weight.shape), shaped)
