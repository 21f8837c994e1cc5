from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.ply_export import (
    ExportedGaussians,
    export_gaussians,
    psnr_to_model_db,
    render_gaussians,
    write_ply,
)
from mirror.errors import UsageError
from tests.model.streets import SOURCES, shifted, street, view

A = Block((0, 0), (0.0, 0.0, 0.0), 40.0, 10.0)
B = Block((1, 0), (30.0, 0.0, 0.0), 40.0, 10.0)
UTM = (441_000.0, 4_475_000.0, 600.0)
LINE = [view(float(x), 0.5) for x in np.arange(-28.0, 4.0, 4.0)]


def select_latents(appearance: AppearanceLatents) -> tuple[torch.Tensor, torch.Tensor]:
    latent = appearance(SOURCES[0])
    return latent, latent


def read_ply(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """Read a PLY as viewers do: a text header, then little-endian float32 values of the properties."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element vertex "))
    table = np.frombuffer(body, "<f4").reshape(count, len(names))
    return lines, dict(zip(names, table.T))


def test_ply_has_the_fields_that_viewers_expect(tmp_path: Path) -> None:
    trained_street = street()
    block = Block((0, 0), UTM)
    views = [view(UTM[0] + x, UTM[1], UTM[2] + 1.5) for x in (-20.0, 0.0, 20.0)]
    exported = export_gaussians([(block, trained_street)], views, select_latents)
    size = write_ply(tmp_path / "street.ply", exported)
    lines, columns = read_ply(tmp_path / "street.ply")
    assert size == (tmp_path / "street.ply").stat().st_size
    assert list(columns) == [
        *"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45)),
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]  # fmt: skip
    assert "comment world origin 441000.0 4475000.0 600.0" in lines
    assert all(np.isfinite(column).all() for column in columns.values())
    places = np.stack([columns[axis] for axis in "xyz"], axis=1)
    assert np.linalg.norm(places, axis=1).max() <= 150.001
    np.testing.assert_allclose(sum(columns[f"rot_{i}"] ** 2 for i in range(4)), 1.0, atol=1e-5)
    # Opacities are stored as logits and scales as logarithms.
    assert columns["opacity"].min() < 0.0 and columns["opacity"].max() < 8.0
    assert columns["scale_0"].min() < 0.0 and np.exp(columns["scale_0"]).max() < 100.0
    # Above the constant, all red coefficients precede all green ones.
    np.testing.assert_array_equal(columns["f_rest_0"], exported.spherical_harmonics[:, 1, 0].numpy())
    np.testing.assert_array_equal(columns["f_rest_15"], exported.spherical_harmonics[:, 1, 1].numpy())
    np.testing.assert_array_equal(columns["f_dc_2"], exported.spherical_harmonics[:, 0, 2].numpy())


def test_pulled_in_sky_stays_behind_the_street() -> None:
    blocks = [(replace(A, origin_m=(100.0 * number, 0.0, 0.0), index=(number, 0)), street()) for number in range(5)]
    views = [view(100.0 * number, 0.5) for number in range(5)]
    near = export_gaussians(blocks, views, select_latents, degree=0, sky="clip", reach_m=150.0)
    whole = export_gaussians(blocks, views, select_latents, degree=0, sky="pull", reach_m=150.0)
    street_ends, sky = (torch.linalg.norm(trained_street.means[:, :2], dim=1).max() for trained_street in (near, whole))
    assert street_ends > 200.0 and sky >= street_ends
    outer = torch.linalg.norm(whole.means, dim=1)
    # No Gaussian of the sky lies within the street.
    assert (outer < float(street_ends) - 1.0).sum() <= len(near)


def test_view_independent_streets_are_exported_exactly() -> None:
    trained_street = street()
    for network in (
        trained_street.background.geometry,
        trained_street.background.colour,
        trained_street.ground.colour,
        trained_street.sky.colour,
    ):
        network.own.data[:, network.code : network.code + 3] = 0.0
    for degree in (0, 1, 3):
        exported = export_gaussians([(A, trained_street)], LINE, select_latents, degree=degree, sky="keep")
        assert exported.spherical_harmonics.shape[1] == (degree + 1) ** 2
        assert psnr_to_model_db(exported, [(A, trained_street)], LINE[:4], select_latents) > 45.0


def test_spherical_harmonics_follow_view_dependent_colours() -> None:
    trained_street = street()
    for network in (trained_street.background.geometry,):
        network.own.data[:, network.code : network.code + 3] = 0.0
    plain, full = (
        psnr_to_model_db(
            export_gaussians([(A, trained_street)], LINE, select_latents, degree=degree, sky="keep"),
            [(A, trained_street)],
            LINE[1::2],
            select_latents,
        )
        for degree in (0, 3)
    )
    assert full > plain and full > 35.0


def test_pulled_in_sky_renders_the_same_from_the_middle() -> None:
    trained_street = street()
    kept, pulled, clipped = (
        export_gaussians([(A, trained_street)], LINE, select_latents, sky=sky) for sky in ("keep", "pull", "clip")
    )
    assert kept.means.norm(dim=1).max() > 290.0
    assert pulled.means.norm(dim=1).max() < 150.1 and len(pulled) == len(kept)
    assert clipped.means.norm(dim=1).max() < 150.1 and len(clipped) < len(kept)
    middle = view(0.0, 0.0, 0.0)
    assert float((render_gaussians(kept, middle) - render_gaussians(pulled, middle)).abs().mean()) < 1e-3


def test_blocks_are_exported_as_one_street() -> None:
    trained_street = street()
    both = [(A, trained_street), (B, shifted(trained_street, np.array([-30.0, 0.0, 0.0])))]
    for node in (trained_street, both[1][1]):
        for network in (node.background.geometry, node.background.colour, node.ground.colour, node.sky.colour):
            network.own.data[:, network.code : network.code + 3] = 0.0
    views = [view(x, 0.5) for x in (-20.0, -10.0, -5.0)]
    assert (
        psnr_to_model_db(export_gaussians(both, views, select_latents, sky="keep"), both, views, select_latents) > 40.0
    )


def test_export_without_views_is_refused() -> None:
    for views, degree in (([], 3), (LINE, 4)):
        with pytest.raises(UsageError, match="degree"):
            export_gaussians([(A, street())], views, select_latents, degree=degree)


def test_distant_export_origin_renders_the_same() -> None:
    trained_street = street()
    near = export_gaussians([(A, trained_street)], LINE, select_latents)
    far = ExportedGaussians(
        near.means, near.quats, near.log_scales, near.logits, near.spherical_harmonics, np.array(UTM)
    )
    there = view(UTM[0] - 10.0, UTM[1], UTM[2] + 1.5)
    torch.testing.assert_close(render_gaussians(near, view(-10.0)), render_gaussians(far, there), atol=1e-4, rtol=0.0)
