from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridworldsim.rendering.prepared import PreparedStreet, seen_rows
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.visible import visible
from hybridworldsim.training.viewpoint import viewpoint_of
from tests.street.streets import SOURCES, street, view


def agree(ours: Splats, theirs: Splats) -> None:
    own, other = torch.isin(ours.rows, theirs.rows), torch.isin(theirs.rows, ours.rows)
    # An opacity at zero may fall on either side.
    assert (~own).sum() + (~other).sum() <= 2
    for name in ("means", "quats", "scales", "opacities", "colours"):
        torch.testing.assert_close(getattr(ours, name)[own], getattr(theirs, name)[other], atol=2e-6, rtol=1e-6)
    assert (ours.held, ours.decoded) == (theirs.held, theirs.decoded)


@pytest.mark.parametrize(("hidden", "k"), [(32, 10), (12, 10), (20, 3), (16, 1)])
def test_compiled_decoding_is_that_of_torch(hidden: int, k: int) -> None:
    one = street(seed=hidden, k=k, hidden=hidden)
    for network in (one.background.geometry, one.background.colour):
        torch.nn.init.normal_(network.own[:, -3:])
    for network in (one.background.colour, one.ground.colour, one.sky.colour):
        torch.nn.init.normal_(network.bend)
    ready = PreparedStreet(one)
    latent, content = (one.appearance(source) for source in SOURCES)
    for place in (view(-25.0), view(3.0, 5.0), view(200.0)):
        viewpoint = viewpoint_of(place, np.zeros(3))
        with torch.no_grad():
            expected = one.decode(viewpoint, latent, content)
        agree(ready.background.decode(viewpoint, latent, content), expected[0])
        agree(ready.ground.decode(viewpoint, latent), expected[1])
        agree(ready.sky.decode(viewpoint, latent), expected[2])


def test_an_empty_street_is_an_empty_picture() -> None:
    one = street(anchors=0)
    for node in (one.ground, one.sky):
        for name, table in list(node.named_parameters(recurse=False)):
            setattr(node, name, torch.nn.Parameter(table.detach()[:0]))
    drawn = PreparedStreet(one)(viewpoint_of(view(), np.zeros(3)), one.appearance(SOURCES[0]))
    assert float(drawn.alpha.abs().max()) == 0.0 and not drawn.rgb.any()


def test_numbers_that_are_not_finite_are_left_out() -> None:
    one = street()
    one.background.codes.data[3] = torch.nan
    one.ground.means.data[5] = torch.inf
    drawn = PreparedStreet(one)(viewpoint_of(view(-25.0), np.zeros(3)), one.appearance(SOURCES[0]))
    assert torch.isfinite(drawn.rgb).all()


def test_the_same_rows_are_seen() -> None:
    rng = torch.Generator().manual_seed(0)
    means = 100.0 * (torch.rand(5000, 3, generator=rng) - 0.5)
    reach = torch.rand(5000, generator=rng)
    for place in (view(), view(-60.0, fx_px=400.0), view(3.0, 3.0, 30.0, fx_px=10.0)):
        viewpoint = viewpoint_of(place, np.zeros(3))
        ours = seen_rows(viewpoint, means.numpy(), reach.numpy())
        assert len(np.setxor1d(ours, visible(viewpoint, means, reach).numpy())) <= 1
