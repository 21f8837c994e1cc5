import math

import pytest

from mirror.errors import UsageError
from mirror.metrics.images.aggregate import Scores, by_group, summarise
from mirror.metrics.score import EMPTY_MASK, Score


def test_the_mean_is_of_finite_scores_and_everything_is_counted():
    summary = summarise([20.0, math.inf, 30.0, EMPTY_MASK, math.nan, EMPTY_MASK])
    assert (summary.n, summary.n_finite, summary.n_inf, summary.n_nan) == (6, 2, 1, 3)
    assert summary.mean == 25.0
    assert summary.mean.reason is None
    assert summary.reasons == {"the mask selects no pixel": 2, "not a number": 1}


def test_a_mean_of_nothing_says_why():
    assert summarise([]).mean.reason == "there is no score"
    assert summarise([math.inf, EMPTY_MASK]).mean.reason == (
        "no score is finite (1 infinite; 1 times: the mask selects no pixel)"
    )
    assert math.isnan(summarise([math.inf]).mean)


def test_order_does_not_count():
    values = [1e16, 1.0, -1e16, 3.0]
    assert summarise(values).mean == summarise(values[::-1]).mean == 1.0


def test_groups_are_summarised_apart_and_their_means_together():
    groups = by_group([10.0, 20.0, 40.0], ["a", "a", "b"])
    assert {name: float(summary.mean) for name, summary in groups.items()} == {"a": 15.0, "b": 40.0}
    assert summarise(summary.mean for summary in groups.values()).mean == 27.5
    with pytest.raises(UsageError, match="1 groups of 2 scores"):
        by_group([1.0, 2.0], ["a"])


def test_scores_accumulate():
    first, second = Scores(), Scores()
    first.update(1.0)
    second.update(Score(2.0))
    first.merge(second)
    assert first.compute() == summarise([1.0, 2.0])


def test_a_score_is_a_float():
    score = Score(1.5)
    assert (score + 1, f"{score:.2f}", isinstance(score, float)) == (2.5, "1.50", True)
