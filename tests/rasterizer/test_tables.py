"""Rows of tables by compiled kernels, against torch's own indexing."""

import math

import pytest
import torch

from hybridworldsim.rasterizer.cpu.tables import sum_table, take_rows

IDS = {"none": [], "first": [0], "last": [99], "gaps": [3, 4, 40, 41, 98], "all": list(range(100))}


@pytest.mark.parametrize("shape", [(), (1,), (3,), (4, 2)])
@pytest.mark.parametrize("ids", IDS.values(), ids=IDS)
def test_rows_and_their_gradients_are_torch_s(ids, shape):
    ids = torch.tensor(ids, dtype=torch.int64)
    table = torch.randn(100, *shape)
    weights = torch.randn(len(ids), *shape)
    found = []
    for take in (take_rows, lambda table, ids: table[ids]):
        leaf = table.clone().requires_grad_()
        part = take(leaf, ids)
        (part * weights).sum().backward()
        found.append((part.detach(), leaf.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])


@pytest.mark.parametrize("ids", IDS.values(), ids=IDS)
def test_a_column_is_put_beside_them(ids):
    ids = torch.tensor(ids, dtype=torch.int64)
    table, column = torch.randn(100, 3, requires_grad=True), torch.randn(len(ids), requires_grad=True)
    part = take_rows(table, ids, column)
    wanted = torch.cat([table[ids], column[:, None]], dim=1)
    assert torch.equal(part, wanted)
    weights = torch.randn(len(ids), 4)
    for one, other in zip(
        torch.autograd.grad((part * weights).sum(), (table, column)),
        torch.autograd.grad((wanted * weights).sum(), (table, column)),
        strict=True,
    ):
        assert torch.equal(one, other)


@pytest.mark.parametrize("count", [0, 1, 7, 100_003])
def test_sums_see_every_number(count):
    table = torch.randn(count)
    assert math.isclose(sum_table(table), float(table.double().sum()), rel_tol=1e-9, abs_tol=1e-9)
    for place in {0, count // 2, count - 1} - {-1} if count else ():
        broken = table.clone()
        broken[place] = torch.inf
        assert not math.isfinite(sum_table(broken))
        broken[place] = torch.nan
        assert not math.isfinite(sum_table(broken))
