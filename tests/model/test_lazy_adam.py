import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from hybridworldsim.model.lazy_adam import BETA1, BETA2, LazyAdam
from tests.draws import draws

RATES = {"table": 0.03, "numbers": 0.2}


def node_of(rows, dtype=torch.float32, seed=0):
    """A module with a table, a vector, and a table without gradient."""
    node, generator = nn.Module(), torch.Generator().manual_seed(seed)
    node.table = nn.Parameter(torch.randn(rows, 2, 3, generator=generator).to(dtype))
    node.numbers = nn.Parameter(torch.randn(rows, generator=generator).to(dtype))
    node.fixed = nn.Parameter(torch.ones(rows, 2, dtype=dtype), requires_grad=False)
    return node


def lazy(node):
    return LazyAdam(node, ("table", "numbers", "fixed"))


def plain(node):
    groups = [{"params": [node.table], "lr": RATES["table"]}, {"params": [node.numbers], "lr": RATES["numbers"]}]
    return torch.optim.Adam(groups, betas=(BETA1, BETA2), eps=1e-15)


def stepped(adam, rows, rng):
    """Take a step with random gradients of some rows; returns the gradients."""
    leaves = adam.begin_step(torch.from_numpy(rows), RATES)
    network_inputs = {name: torch.from_numpy(rng.normal(size=leaf.shape)).float() for name, leaf in leaves.items()}
    for name, leaf in leaves.items():
        leaf.grad = network_inputs[name]
    adam.end_step()
    return network_inputs


def both_stepped(adam, rows, rng, reference, exact):
    """Take the same step with both optimisers; the reference gets zero gradients for the other rows."""
    for name, gradient in stepped(adam, rows, rng).items():
        whole = torch.zeros_like(exact.get_parameter(name))
        whole[torch.from_numpy(rows)] = gradient.double()
        exact.get_parameter(name).grad = whole
    reference.step()


def some(rng, count, share):
    return np.flatnonzero(rng.random(count) < share).astype(np.int64)


@given(st.integers(0, 10_000), st.integers(1, 60), st.sampled_from([0.02, 0.3, 1.0]))
@settings(max_examples=draws(40), deadline=None)
def test_rows_match_adam_with_zero_gradients(seed, steps, share):
    rng = np.random.default_rng(seed)
    one, exact = node_of(30), node_of(30, torch.float64)
    exact.load_state_dict(one.state_dict())
    adam, reference = lazy(one), plain(exact)
    for _ in range(steps):
        both_stepped(adam, some(rng, 30, share), rng, reference, exact)
    adam.catch_up(RATES)
    for name in ("table", "numbers", "fixed"):
        torch.testing.assert_close(
            one.get_parameter(name).detach().double(), exact.get_parameter(name).detach(), rtol=1e-4, atol=1e-4
        )


def test_a_row_used_once_in_a_thousand_steps_matches_adam():
    one, exact = node_of(2), node_of(2, torch.float64)
    adam, reference, rng = lazy(one), plain(exact), np.random.default_rng(0)
    for step in range(2001):
        both_stepped(adam, np.array([0, 1] if step % 1000 == 0 else [0]), rng, reference, exact)
    adam.catch_up(RATES)
    assert one.table[1].detach().sub(exact.table[1].detach()).abs().max() < 1e-5
    assert one.table[0].detach().sub(exact.table[0].detach()).abs().max() < 1e-3


def test_moments_fade_while_the_rate_is_zero():
    one, exact = node_of(2), node_of(2, torch.float64)
    adam, reference, rng = lazy(one), plain(exact), np.random.default_rng(0)
    both_stepped(adam, np.array([0, 1]), rng, reference, exact)
    adam.catch_up(dict.fromkeys(RATES, 0.0))
    for _ in range(20):
        adam.begin_step(torch.tensor([0]), dict.fromkeys(RATES, 0.0))
        adam.end_step()
    adam.catch_up(dict.fromkeys(RATES, 0.0))
    for group in reference.param_groups:
        group["lr"] = 0.0
    exact.zero_grad(set_to_none=False)
    for _ in range(20):
        reference.step()
    for group, rate in zip(reference.param_groups, RATES.values()):
        group["lr"] = rate
    both_stepped(adam, np.array([0, 1]), rng, reference, exact)
    for name in RATES:
        torch.testing.assert_close(
            one.get_parameter(name).detach().double(), exact.get_parameter(name).detach(), rtol=1e-4, atol=1e-4
        )


def test_unused_rows_do_not_move():
    node = node_of(3)
    before, adam, rng = node.table.detach().clone(), lazy(node), np.random.default_rng(0)
    for _ in range(5):
        stepped(adam, np.array([1]), rng)
    adam.catch_up(RATES)
    assert torch.equal(node.table.detach()[[0, 2]], before[[0, 2]])
    assert not torch.equal(node.table.detach()[1], before[1])


def test_gathered_rows_are_up_to_date():
    node = node_of(4)
    adam, rng = lazy(node), np.random.default_rng(0)
    stepped(adam, np.array([0, 2]), rng)
    leaves = adam.begin_step(torch.tensor([0, 2, 3]), RATES)
    for name, leaf in leaves.items():
        assert torch.equal(leaf.detach(), node.get_parameter(name).detach()[[0, 2, 3]])
    before = node.table.detach().clone()
    adam.end_step()
    assert (node.table.detach() != before).flatten(1).any(1).tolist() == [True, False, True, False]


def test_rows_take_their_moments_with_them():
    node = node_of(4)
    adam, rng = lazy(node), np.random.default_rng(0)
    stepped(adam, np.arange(4), rng)
    adam.catch_up(RATES)
    value, before = node.table.detach().clone(), adam.state()
    added = {"table": torch.full((1, 2, 3), 9.0), "numbers": torch.zeros(1), "fixed": torch.zeros(1, 2)}
    adam.replace(torch.tensor([1, 3]), added)
    after = adam.state()
    assert torch.equal(node.table.detach(), torch.cat([value[[1, 3]], added["table"]]))
    for moment in ("first", "second"):
        kept = before[f"{moment}.table"][[1, 3]]
        assert torch.equal(after[f"{moment}.table"], torch.cat([kept, torch.zeros(1, 2, 3)]))
    assert adam.numbers.tolist() == [1, 3, 4]
    assert node.fixed[:, 0].tolist() == [1.0, 1.0, 0.0]
    assert not node.fixed.requires_grad
    adam.replace(torch.tensor([0, 1]), added)
    assert adam.numbers.tolist() == [1, 3, 5], "a number means one row for ever"
    stepped(adam, np.arange(3), rng)


def test_restored_optimizer_continues_exactly():
    def begun():
        node = node_of(20)
        return node, lazy(node)

    (one, adam), rng = begun(), np.random.default_rng(3)
    for _ in range(9):
        stepped(adam, some(rng, 20, 0.3), rng)
    other, again = begun()
    other.load_state_dict(one.state_dict())
    again.restore({name: table.clone() for name, table in adam.state().items()})
    for each in (adam, again):
        rng = np.random.default_rng(4)
        for _ in range(9):
            stepped(each, some(rng, 20, 0.3), rng)
        each.catch_up(RATES)
    assert torch.equal(one.table, other.table)
    assert torch.equal(one.numbers, other.numbers)


@pytest.mark.parametrize("rows", [[], [0]])
def test_empty_steps_and_empty_nodes_are_accepted(rows):
    node = node_of(len(rows))
    adam = lazy(node)
    leaves = adam.begin_step(torch.tensor(rows, dtype=torch.int64), RATES)
    assert leaves["table"].shape == (len(rows), 2, 3)
    adam.end_step()
    adam.catch_up(RATES)


def test_results_do_not_depend_on_the_number_of_threads():
    threads, found = torch.get_num_threads(), []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            node = node_of(6000)
            adam, rng = lazy(node), np.random.default_rng(0)
            for _ in range(3):
                stepped(adam, some(rng, 6000, 0.5), rng)
            adam.catch_up(RATES)
            found.append(node.table.detach().clone())
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*found)
