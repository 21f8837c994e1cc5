"""SPZ against the PLY that it was made of, read by the bytes of its specification."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.methods.spz import write_spz

gsply = pytest.importorskip("gsply")


def write_ply(path: Path, means: np.ndarray) -> None:
    count = len(means)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += ["rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros((count, len(names)), "<f4")
    table[:, :3], table[:, 6:9], table[:, 9] = means, 0.4, 2.0
    table[:, 10:13], table[:, 13] = -3.0, 1.0
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [*(f"property float {name}" for name in names), "end_header\n"]
    path.write_bytes("\n".join(head).encode() + table.tobytes())


def test_the_bytes_are_those_of_the_specification(tmp_path: Path) -> None:
    means = np.random.default_rng(0).uniform(-150, 150, (500, 3)).astype(np.float32)
    write_ply(tmp_path / "a.ply", means)
    written = write_spz(tmp_path / "a.ply", tmp_path / "a.spz")
    assert written.gaussians == 500 and written.bytes == (tmp_path / "a.spz").stat().st_size
    raw = gzip.decompress((tmp_path / "a.spz").read_bytes())
    magic, version, count, degree, fraction, _, _ = struct.unpack_from("<IIIBBBB", raw)
    assert (magic, version, count, degree, fraction) == (0x5053474E, 3, 500, 0, 12) and written.step_m == 2.0**-12
    packed = np.frombuffer(raw, np.uint8, 500 * 9, 16).reshape(500, 3, 3).astype(np.int64)
    fixed = packed[..., 0] | (packed[..., 1] << 8) | (packed[..., 2] << 16)
    found = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed) / 4096.0
    assert np.abs(found - means).max() <= 0.5 / 4096.0 + 1e-5
    alphas = np.frombuffer(raw, np.uint8, 500, 16 + 500 * 9)
    assert set(alphas.tolist()) == {round(255.0 / (1.0 + np.exp(-2.0)))}


def test_far_gaussians_get_coarser_steps_and_too_far_ones_are_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "far.ply", np.array([[5000.0, 0.0, 0.0], [1.0, 2.0, 3.0]], np.float32))
    assert write_spz(tmp_path / "far.ply", tmp_path / "far.spz").step_m == 2.0**-10
    write_ply(tmp_path / "sky.ply", np.array([[1e6, 0.0, 0.0]], np.float32))
    with pytest.raises(UsageError, match="--sky pull"):
        write_spz(tmp_path / "sky.ply", tmp_path / "sky.spz")
    assert not (tmp_path / "sky.spz").exists()
