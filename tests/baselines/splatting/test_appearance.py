"""Appearances of the baselines: spherical harmonics of a traversal, exposures, embeddings, the sky cube."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from hybridworldsim.model.settings import Rate
from hybridworldsim.trainable.viewpoint import Source
from mirror.errors import UsageError
from mirror_baselines import mtgs_style, omnire_style
from mirror_baselines.omnire_style.sky_cube import SkyCube
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.settings import LearningRates
from tests.baselines.splatting.scenes import GROWING, SOURCES, image, initial, small, stripes, viewpoint

A, B = SOURCES


def _mtgs(**changes):
    rates = LearningRates(sh0=Rate(1e-2, 1e-3), shN=Rate(1e-2, 1e-3), adapter=Rate(1e-2, 1e-3))
    return mtgs_style.make(
        initial(), replace(small(mtgs_style.RELEASED, densification=GROWING), rates=rates, **changes)
    )


def test_a_traversal_trains_only_its_own_spherical_harmonics():
    trainer = _mtgs()
    names = [name for name in trainer.model.tables if name.endswith("_1")]
    assert sorted(names) == ["adapter_1", "shN_1"]
    before = {name: trainer.model.tables[name].detach().clone() for name in trainer.model.tables}
    trainer.step(image(stripes(), viewpoint(0.0, A)), 0.01)
    trainer.step(image(stripes(), viewpoint(0.1, A)), 0.04)  # the first band is active
    after = trainer.model.tables
    assert all(torch.equal(before[name], after[name]) for name in names)
    assert not torch.equal(before["shN_0"], after["shN_0"])
    assert not torch.equal(before["adapter_0"], after["adapter_0"])
    rows, source = torch.arange(len(after["means"])), B
    shared = trainer.model.spherical_harmonics(rows, source)
    torch.testing.assert_close(shared[:, :1], after["sh0"].detach())
    assert (shared[:, 1:] == 0.0).all()


def test_spherical_harmonics_are_the_sum_of_shared_and_own_coefficients():
    trainer = _mtgs()
    tables = trainer.model.tables
    with torch.no_grad():
        trainer.model.sh_degree.fill_(1)
        tables["adapter_1"].fill_(0.25)
        tables["shN_1"].fill_(2.0)
    rows = torch.tensor([0, 3, 7])
    found = trainer.model.spherical_harmonics(rows, B)
    torch.testing.assert_close(found[:, :1], tables["sh0"].detach()[rows] + 0.25)
    assert found.shape == (3, 4, 3) and (found[:, 1:] == 2.0).all()
    torch.testing.assert_close(trainer.model.spherical_harmonics(rows, A)[:, :1], tables["sh0"].detach()[rows])


def test_only_training_images_have_exposures():
    trainer = _mtgs(exposure=Rate(1e-1, 1e-1))
    taken, novel = viewpoint(0.0, A), viewpoint(0.2, A)
    trainer.step(image(stripes(), taken), 0.5)
    exposures = trainer.model.look.exposures
    assert not torch.equal(exposures.table.detach()[0], torch.eye(3, 4).flatten())
    plain, shown = trainer.render(novel).rgb, trainer.render(taken).rgb
    with torch.no_grad():
        exposures.table.add_(0.3)
    assert torch.equal(trainer.render(novel).rgb, plain)
    assert torch.equal(trainer.render(taken.with_source(B)).rgb, trainer.render(viewpoint(0.0, B)).rgb)
    assert not torch.equal(trainer.render(taken).rgb, shown)


def test_without_a_rate_there_is_no_exposure():
    trainer = _mtgs(exposure=None)
    trainer.step(image(stripes()), 0.5)
    assert not len(trainer.model.look.exposures.table)


def test_untrained_traversal_is_refused():
    with pytest.raises(UsageError, match="elsewhere"):
        _mtgs().render(viewpoint(0.0, Source("elsewhere", "front")))


def test_untrained_image_uses_the_mean_embedding():
    settings = replace(small(omnire_style.RELEASED, densification=GROWING), affine=Rate(1e-2, 1e-2))
    trainer = omnire_style.make(initial(), settings)
    for place, value in ((0.0, 0.2), (0.1, 0.8), (0.0, 0.2), (0.1, 0.8)):
        trainer.step(image(value, viewpoint(place)), 0.3)
    embeddings = trainer.model.look.embeddings
    assert embeddings.table.shape == (2, settings.embedding)
    novel = trainer.render(viewpoint(0.05)).rgb
    with torch.no_grad():
        embeddings.table[:] = embeddings.table.mean(0)
    torch.testing.assert_close(trainer.render(viewpoint(0.05)).rgb, novel)


def test_initial_colour_map_is_the_identity():
    trainer = omnire_style.make(initial(), small(omnire_style.RELEASED))
    before = trainer.render(viewpoint()).rgb
    trainer.model.look.prepare(viewpoint(), 0.0)
    torch.testing.assert_close(trainer.render(viewpoint()).rgb, before)


def test_opacity_loss_makes_only_pixels_outside_the_sky_opaque():
    trainer = omnire_style.make(initial(), small(omnire_style.RELEASED))
    taken = image(0.5)
    alpha = torch.full(taken.sky.shape, 0.5, requires_grad=True)
    ((weight, loss),) = trainer.model.look.losses(alpha, taken).values()
    loss.backward()
    assert weight > 0.0
    assert (alpha.grad[taken.sky] > 0.0).all() and (alpha.grad[~taken.sky] < 0.0).all()
    assert not trainer.model.look.losses(alpha, replace(taken, sky=None))


def _texel_directions(size: int) -> torch.Tensor:
    """(size, 6 size, 3) directions of the pixel centres of all faces, by the definition of a cube map."""
    steps = (torch.arange(size) + 0.5) / size * 2.0 - 1.0
    found = torch.empty(size, 6 * size, 3)
    for face in range(6):
        axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
        part = found[:, face * size : (face + 1) * size]
        part[..., axis] = sign
        part[..., (axis + 1) % 3] = steps[None, :]
        part[..., (axis + 2) % 3] = steps[:, None]
    return found


def test_sky_cube_samples_each_direction():
    cube = SkyCube(64)
    rays = torch.nn.functional.normalize(_texel_directions(64), dim=-1)
    with torch.no_grad():
        cube.faces.copy_(rays.permute(2, 0, 1)[None])
        torch.testing.assert_close(cube.sample(3.0 * rays), rays, rtol=0, atol=1e-5)
        torch.manual_seed(0)
        anywhere = torch.nn.functional.normalize(torch.randn(40, 50, 3), dim=-1)
        torch.testing.assert_close(cube.sample(anywhere), anywhere, rtol=0, atol=0.03)


def test_sky_cube_ignores_position_and_learns_visible_directions():
    cube = SkyCube(16)
    assert torch.equal(cube(viewpoint(0.0)), cube(viewpoint(50.0)))
    cube(viewpoint()).sum().backward()
    forward = cube.faces.grad[0, 0, :, :16]  # the face of +x, in front of the camera
    assert forward.abs().sum() > 0.0 and cube.faces.grad[..., 16:32].abs().sum() == 0.0


def test_only_the_sky_cube_method_has_no_sky_gaussians():
    street = initial()
    plain = replace(mtgs_style.RELEASED.seeding, sky_count=60)
    dome = initial_gaussians(street, plain)["means"][:, 2].max()
    assert dome > 3.0 * street.radius_m
    without = initial_gaussians(street, replace(plain, sky_count=0))["means"]
    assert without[:, 2].max() < street.radius_m and len(without) == len(initial_gaussians(street, plain)["means"]) - 60
    assert not omnire_style.RELEASED.seeding.sky_count and not omnire_style.TUNED.seeding.sky_count
