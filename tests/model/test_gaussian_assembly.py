import pytest
import torch

from hybridworldsim.model.nodes.gaussian_assembly import anchors_to_gaussians
from hybridworldsim.model.plain.decoding import anchors_to_gaussians as plain


def tables(anchors, k=4, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def numbers(*shape):
        return torch.randn(*shape, generator=generator)

    return (
        numbers(anchors, 8 * k).requires_grad_(),
        numbers(anchors, 3 * k).requires_grad_(),
        numbers(anchors, 3),
        numbers(anchors, k, 3).requires_grad_(),
        numbers(anchors, 6).requires_grad_(),
    )


@pytest.mark.parametrize("anchors", [50, 1, 0, 3000])
def test_gaussians_and_gradients_match_plain_torch(anchors):
    given = tables(anchors)
    found, expected = anchors_to_gaussians(*given), plain(*given)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)
    weights = [torch.randn(one.shape, generator=torch.Generator().manual_seed(1)) for one in found[:5]]
    leaves = [table for table in given if table.requires_grad]
    ours = torch.autograd.grad(sum((w * one).sum() for w, one in zip(weights, found)), leaves)
    theirs = torch.autograd.grad(sum((w * one).sum() for w, one in zip(weights, expected)), leaves)
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=2e-5, atol=2e-6)


def test_transparent_anchors_give_no_gaussians():
    geometry, *rest = tables(20)
    found = anchors_to_gaussians(-geometry.abs(), *rest)
    assert [len(one) for one in found] == [0] * 6


def test_results_do_not_depend_on_the_number_of_threads():
    given = tables(5000)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = anchors_to_gaussians(*given)
        torch.set_num_threads(2)
        two = anchors_to_gaussians(*given)
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(one, two))


def test_extreme_inputs_stay_finite():
    geometry, colours, *rest = tables(4)
    found = anchors_to_gaussians(geometry * 1e4, colours * 1e4, *rest)
    assert all(torch.isfinite(one).all() for one in found[:5])
    sum(one.sum() for one in found[:5]).backward()
    assert all(torch.isfinite(table.grad).all() for table in (geometry, colours, rest[1], rest[2]))
