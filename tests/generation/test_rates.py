"""What is said of the rate of generated frames, and the rate that a plan has where none is asked for."""

from __future__ import annotations

import pytest

from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.rates import plan_rates, rate_note, rate_of
from mirror.dataset.dataset import Dataset
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views


@pytest.mark.parametrize(
    ("used", "trained", "note"),
    [
        ([5.0], (5.0, 5.0), ""),
        ([4.2, 5.9], (5.0, 5.0), ""),
        ([], None, ""),
        ([4.0], (5.0, 5.0), "at 4 Hz, the generator was trained at 5 Hz"),
        ([5.0, 7.0], (5.0, 5.0), "at 5 to 7 Hz, the generator was trained at 5 Hz"),
        ([8.0], (5.0, 10.0), ""),
        ([2.0], (5.0, 10.0), "at 2 Hz, the generator was trained at 5 to 10 Hz"),
        ([5.0], None, "at 5 Hz; the generator's file does not state the rate of its training"),
    ],
)
def test_another_rate_than_that_of_the_training_is_stated(
    used: list[float], trained: tuple[float, float] | None, note: str
) -> None:
    found = rate_note(used, trained)
    assert (note in found) if note else not found


def test_a_gap_does_not_change_the_rate() -> None:
    assert rate_of([0, 200_000_000, 400_000_000, 9_000_000_000]) == pytest.approx(5.0)


def test_the_rates_of_a_plan_are_those_of_its_frames(tiny_dataset: Dataset) -> None:
    """The tiny dataset has a frame every two seconds; every fifth one is asked for by the protocol of edits."""
    for protocol, rate in (("generation", 0.5), ("editing-accuracy-small", 0.1)):
        plan = plan_views(tiny_dataset, load_protocol(protocol), "novel")
        rollouts = {(view.group, view.traversal_id) for view in plan.views}
        assert plan_rates(tiny_dataset, plan) == [pytest.approx(rate, rel=0.01)] * len(rollouts)


def test_a_scene_has_the_rate_of_the_training_unless_another_is_asked_for(
    tiny_dataset: Dataset, traversal: str
) -> None:
    def rate(hz: float | None, trained_hz: float) -> float:
        plan = plan_scene(
            tiny_dataset, traversal, hz=hz, trajectory=None, references=2, count=None, trained_hz=trained_hz
        )
        return plan.rate_hz

    assert rate(None, 0.25) == rate(0.25, 5.0) == pytest.approx(0.25, rel=0.01)
    assert rate(None, 5.0) == rate(0.5, 0.25) == pytest.approx(0.5, rel=0.01)
