"""Detection metrics bit by bit against loops over the definitions, and cases worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.metrics.detection import (
    DETECTION_CVPR_2019,
    TP_ERRORS,
    DetectionBoxes,
    DetectionConfig,
    NuScenesAccumulator,
    NuScenesDetection,
    in_range,
    matching_tables,
    nuscenes_detection,
)
from tests.draws import draws
from tests.metrics.detection.reference import evaluate
from tests.metrics.detection.scenes import ATTRIBUTES, CLASSES, boxes, random_scene


def require_same_bits(ours: NuScenesDetection, truth: DetectionBoxes, predictions: DetectionBoxes) -> None:
    expected = evaluate(truth, predictions, ours.config)
    for key, curve in ours.curves.items():
        np.testing.assert_array_equal(curve.precision, expected["curves"][key]["precision"])
        np.testing.assert_array_equal(curve.confidence, expected["curves"][key]["confidence"])
        for name in TP_ERRORS:
            np.testing.assert_array_equal(curve.errors[name], expected["curves"][key][name])
    np.testing.assert_array_equal(ours.label_aps, expected["aps"])
    np.testing.assert_array_equal(ours.label_tp_errors, expected["errors"])
    assert float(ours.mean_ap) == expected["mean_ap"]
    assert {name: float(error) for name, error in ours.tp_errors.items()} == expected["tp_errors"]
    assert float(ours.nds) == expected["nds"]


@pytest.mark.parametrize("ties", [True, False])
@pytest.mark.parametrize(("samples", "per_sample", "predicted"), [(1, 1, 1), (3, 5, 8), (20, 12, 40), (8, 60, 150)])
def test_every_bit_is_that_of_the_loops(samples: int, per_sample: int, predicted: int, ties: bool) -> None:
    truth, predictions = random_scene(samples, per_sample, predicted, samples, ties=ties)
    require_same_bits(nuscenes_detection(truth, predictions), truth, predictions)


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 6), st.integers(1, 12))
@settings(max_examples=draws(40), deadline=None)
def test_small_scenes_full_of_ties(seed: int, samples: int, per_sample: int, predicted: int) -> None:
    generator = np.random.default_rng(seed)
    truth, predictions = random_scene(samples, per_sample, predicted, seed, ["car", "barrier"])
    coarse = dataclasses.replace(
        predictions,
        score=np.round(predictions.score, 1),
        centre_m=np.round(predictions.centre_m),
        attribute=generator.choice(ATTRIBUTES, len(predictions)),
    )
    truth = dataclasses.replace(truth, centre_m=np.round(truth.centre_m))
    require_same_bits(nuscenes_detection(truth, coarse), truth, coarse)


def test_perfect_detections() -> None:
    truth, _ = random_scene(10, 40, 1, 3)
    truth = dataclasses.replace(truth, velocity_mps=np.zeros((len(truth), 2)), attribute=np.full(len(truth), "a"))
    result = nuscenes_detection(truth, dataclasses.replace(truth, score=np.ones(len(truth))))
    assert float(result.mean_ap) == pytest.approx(1.0, abs=1e-15)
    assert float(result.nds) == pytest.approx(1.0, abs=1e-15)
    assert all(float(error) == pytest.approx(0.0, abs=1e-15) for error in result.tp_errors.values())
    assert result.absent_classes == ()


def test_nothing_found_and_nothing_there() -> None:
    truth, predictions = random_scene(3, 5, 8)
    for result in (nuscenes_detection(truth, predictions[:0]), nuscenes_detection(truth[:0], predictions)):
        assert float(result.mean_ap) == 0.0
        assert float(result.nds) == 0.0
        assert {float(error) for error in result.tp_errors.values()} == {1.0}
    nothing = nuscenes_detection(truth[:0], predictions[:0], absent="present")
    assert np.isnan(nothing.mean_ap)
    assert nothing.mean_ap.reason == "no class has a true box"
    assert nothing.nds.reason == "no class has a true box"
    assert len(nothing.absent_classes) == 10


def test_absent_classes_count_as_zero_or_not_at_all() -> None:
    truth, predictions = random_scene(10, 20, 30, 5, ["car", "pedestrian"])
    devkit, present = (nuscenes_detection(truth, predictions, absent=name) for name in ("devkit", "present"))
    assert devkit.absent_classes == present.absent_classes == tuple(CLASSES[1:5] + CLASSES[6:])
    assert float(devkit.mean_ap) == pytest.approx(float(present.mean_ap) * 2 / 10, rel=1e-14)
    for column, name in enumerate(TP_ERRORS):
        both = present.label_tp_errors[[0, 5], column]
        assert float(present.tp_errors[name]) == pytest.approx(both.mean(), rel=1e-14)
    assert float(present.nds) > float(devkit.nds)
    require_same_bits(devkit, truth, predictions)


def test_of_equal_scores_the_later_row_takes_the_box() -> None:
    truth = boxes(["a"], ["car"], [[0.0, 0.0, 0.0]])
    near_last = boxes(["a", "a"], ["car"] * 2, [[1.5, 0, 0], [0.1, 0, 0]], score=[0.5, 0.5])
    near_first = near_last[::-1]
    # At 0.5 m only the nearer one can match: found at once, or after a false positive (0 at recall 0, 0.5 at 1).
    assert nuscenes_detection(truth, near_last).curves["car", 0.5].precision[50] == 1.0
    assert nuscenes_detection(truth, near_first).curves["car", 0.5].precision[50] == 0.25
    assert nuscenes_detection(truth, near_last).curves["car", 2.0].errors["trans_err"][50] == 0.1
    assert nuscenes_detection(truth, near_first).curves["car", 2.0].errors["trans_err"][50] == 1.5


def test_a_threshold_is_not_a_match_and_of_equally_near_boxes_the_first_is_taken() -> None:
    truth = boxes(["a", "a"], ["car"] * 2, [[2.0, 0, 0], [-2.0, 0, 0]], yaw=[0.25, 0.5])
    found = boxes(["a"], ["car"], [[0.0, 0, 0]], score=[1.0])
    result = nuscenes_detection(truth, found)
    assert not result.curves["car", 2.0].precision.any()
    assert result.curves["car", 4.0].precision[50] == 1.0
    assert result.curves["car", 4.0].errors["orient_err"][50] == 0.25


def test_half_turns_and_height_do_not_matter_where_they_should_not() -> None:
    truth = boxes(["a", "a"], ["car", "barrier"], [[0, 0, 0], [9, 0, 0]])
    found = boxes(["a", "a"], ["car", "barrier"], [[0, 0, 80.0], [9, 0, -80.0]], yaw=[np.pi] * 2, score=[1.0] * 2)
    curves = nuscenes_detection(truth, found).curves
    assert curves["car", 2.0].errors["orient_err"][50] == pytest.approx(np.pi)
    assert curves["barrier", 2.0].errors["orient_err"][50] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("offset", [1e6, 1e8])
def test_far_from_the_origin_the_loops_agree_too(offset: float) -> None:
    truth, predictions = random_scene(5, 10, 20, 7)
    far, far_predictions = (dataclasses.replace(b, centre_m=b.centre_m + offset) for b in (truth, predictions))
    result = nuscenes_detection(far, far_predictions)
    require_same_bits(result, far, far_predictions)
    near = nuscenes_detection(truth, predictions)
    assert float(result.mean_ap) == pytest.approx(float(near.mean_ap), abs=0.02)


def test_updates_and_merges_are_one_computation() -> None:
    truth, predictions = random_scene(9, 10, 20, 2)
    whole = nuscenes_detection(truth, predictions)
    parts = [NuScenesAccumulator(), NuScenesAccumulator()]
    for number in range(9):
        chosen = [b[b.sample == f"s{number}"] for b in (truth, predictions)]
        parts[number > 4].update(*chosen)
    parts[0].merge(parts[1])
    merged = parts[0].compute()
    assert str(merged.to_dict()) == str(whole.to_dict())
    np.testing.assert_array_equal(merged.label_aps, whole.label_aps)
    with pytest.raises(UsageError, match="no samples"):
        NuScenesAccumulator().compute()
    with pytest.raises(UsageError, match="configurations"):
        parts[0].merge(NuScenesAccumulator(absent="present"))


def test_samples_may_be_numbers_and_rows_need_not_be_sorted() -> None:
    truth, predictions = random_scene(6, 8, 15, 4, ties=False)
    order = np.random.default_rng(1).permutation(len(predictions))
    assert str(nuscenes_detection(truth, predictions[order]).to_dict()) == str(
        nuscenes_detection(truth, predictions).to_dict()
    )
    numbers = [dataclasses.replace(b, sample=np.array([int(s[1:]) for s in b.sample])) for b in (truth, predictions)]
    assert str(nuscenes_detection(*numbers).to_dict()) == str(nuscenes_detection(truth, predictions).to_dict())


def test_tables_hold_what_is_near_and_nothing_else() -> None:
    truth, predictions = random_scene(6, 30, 40, 4)
    tables = matching_tables(truth, predictions, DETECTION_CVPR_2019)
    assert sum(table.truths for table in tables.values()) == len(truth)
    for name, table in tables.items():
        for rank, row in enumerate(table.predictions):
            alike = (truth.sample == predictions.sample[row]) & (truth.category == name)
            distance = np.linalg.norm(truth.centre_m[:, :2] - predictions.centre_m[row, :2], axis=1)
            np.testing.assert_array_equal(
                table.truth[table.first[rank] : table.first[rank + 1]], np.flatnonzero(alike & (distance < 4.0))
            )


def test_ranges() -> None:
    found = boxes(["a"] * 4, ["car", "car", "barrier", "barrier"], [[30, 40, 0], [30, 39.9, 9], [30, 0, 0], [0, 29, 0]])
    assert in_range(found, (0.0, 0.0), DETECTION_CVPR_2019).tolist() == [False, True, False, True]
    moved = dataclasses.replace(found, centre_m=np.add(found.centre_m, (1e6, -1e6, 0)))
    assert in_range(moved, [[1e6, -1e6]] * 4, DETECTION_CVPR_2019).tolist() == [False, True, False, True]
    with pytest.raises(UsageError, match="row 1"):
        in_range(boxes(["a"] * 2, ["car", "tram"], np.zeros((2, 3))), (0.0, 0.0), DETECTION_CVPR_2019)


def test_boxes_by_their_poses() -> None:
    angles = np.array([0.3, -2.0, 3.0])
    rotation = np.stack((np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)), axis=-1)
    made = DetectionBoxes.from_poses(["a"] * 3, ["car"] * 3, Poses(rotation, np.ones((3, 3))), np.ones((3, 3)))
    np.testing.assert_allclose(made.yaw_rad, angles, rtol=1e-15)
    assert np.isnan(made.velocity_mps).all()
    assert made.attribute.tolist() == [""] * 3


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("centre_m", np.nan),
        ("centre_m", np.inf),
        ("lwh_m", 0.0),
        ("lwh_m", np.nan),
        ("lwh_m", -1.0),
        ("yaw_rad", np.nan),
        ("velocity_mps", np.inf),
        ("score", np.nan),
        ("score", -0.1),
        ("score", np.inf),
    ],
)
def test_numbers_that_no_box_has_are_named(field: str, value: float) -> None:
    truth, _ = random_scene(1, 4, 1)
    wrong = getattr(truth, field).copy()
    wrong[2] = value
    with pytest.raises(UsageError, match=f"row 2: {field}"):
        dataclasses.replace(truth, **{field: wrong})
    with pytest.raises(UsageError, match=f"{field} of shape"):
        dataclasses.replace(truth, **{field: wrong[:2]})


def test_too_many_predictions_and_unknown_names() -> None:
    truth, predictions = random_scene(2, 4, 6)
    few = dataclasses.replace(DETECTION_CVPR_2019, max_boxes_per_sample=5)
    with pytest.raises(UsageError, match="sample s0: 6 predictions"):
        nuscenes_detection(truth, predictions, few)
    with pytest.raises(UsageError, match="absent"):
        nuscenes_detection(truth, predictions, absent="zero")
    tram = dataclasses.replace(predictions, category=np.full(len(predictions), "tram"))
    with pytest.raises(UsageError, match="tram"):
        nuscenes_detection(truth, tram)


def test_configurations_are_data() -> None:
    assert DetectionConfig.from_dict(DETECTION_CVPR_2019.to_dict()) == DETECTION_CVPR_2019
    values = DETECTION_CVPR_2019.to_dict()
    for change in (
        {"dist_fcn": "iou"},
        {"dist_ths": [1.0]},
        {"dist_ths": [-1.0, 2.0]},
        {"min_recall": 1.0},
        {"min_precision": 1.0},
        {"class_range": {}},
        {"class_range": {"car": 50}},
        {"undefined_errors": {"car": ["size_err"]}},
        {"extra": 1},
    ):
        with pytest.raises(UsageError):
            DetectionConfig.from_dict({**values, **change})
    with pytest.raises(UsageError, match="missing \\['min_recall'\\]"):
        DetectionConfig.from_dict({name: value for name, value in values.items() if name != "min_recall"})
