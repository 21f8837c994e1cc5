"""OpenSplat as a peer: its input and output files, with a stand-in program."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.rasterizer import opensplat, scenes

STAND_IN = f"""#!{sys.executable}
import sys
import numpy as np
given = np.fromfile(sys.argv[1], np.float32)
count, width, height = given[:3].view(np.int32)
image = given[-width * height * 3:]
arrays = given[3 + 4 + 16 : -width * height * 3]
assert len(arrays) == count * (3 + 4 + 3 + 1 + 3)
np.concatenate([image * given[3], arrays]).tofile(sys.argv[2])
print(1.5, 2.0, float(sys.argv[3]), float(sys.argv[4]))
"""


def test_program_renders_the_scene(tmp_path: Path) -> None:
    find_program = tmp_path / "program"
    find_program.write_text(STAND_IN)
    find_program.chmod(0o755)
    scene = scenes.street(20)
    answer = opensplat.run(find_program, scene, np.full((6, 8, 3), 2.0, np.float32), repeats=3, threads=4)
    assert (answer.forward_ms, answer.backward_ms) == (3.5, 7.0)
    np.testing.assert_array_equal(answer.image, np.full((6, 8, 3), 2.0 * np.float32(scene.focal[0] * 8)))
    for name, gradient in answer.gradients.items():
        np.testing.assert_array_equal(gradient, getattr(scene, name))


def test_no_program_without_a_configured_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(opensplat.VARIABLE, raising=False)
    assert opensplat.find_program() is None
