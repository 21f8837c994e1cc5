"""Appearance policies on a street of parallel lines."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.appearance import AppearanceSelector, trained_cameras
from hybridworldsim.training.driven_lines import DrivenLines, chamfer_m, densify_line
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView
from tests.training.street import Painted, trainer, view

CAMERAS = ("front_wide", "rear")
BACK = (0.5, -0.5, -0.5, 0.5)
"""Rotation of a camera that looks along minus x."""


def line(traversal: str, y_m: float, cameras: tuple[str, ...] = CAMERAS, weather: str = "clear") -> list[RenderView]:
    choice = []
    for frame in range(10):
        for camera in cameras:
            one = view(traversal, frame, camera)
            quaternion = BACK if "rear" in camera else tuple(one.world_SE3_camera.rotation[0].tolist())
            pose = (*quaternion, 1.0 * frame, y_m, 1.5)
            choice.append(one.model_copy(update={"world_SE3_camera": pose, "weather": weather}))
    return choice


TRAINED = [*line("s.day.0", 0.0), *line("s.day.1", 8.0, weather="rain"), *line("s.night.0", 4.0)]
TRAINED_CAMERAS = trained_cameras(TRAINED)


def select(policy: str, views: list[RenderView], index: int = 0, everywhere: bool = False):
    return AppearanceSelector(TRAINED_CAMERAS, policy, views, everywhere).select(views[index])


def test_trained_traversals_keep_their_appearance() -> None:
    for policy in ("nearest", "mean", "night"):
        assert select(policy, TRAINED).colours == ((Source("s.day.0", "front_wide"), 1.0),)


def test_nearest_policy_selects_the_nearest_line() -> None:
    for y_m, expected in ((1.0, "s.day.0"), (3.5, "s.night.0"), (30.0, "s.day.1")):
        choice = select("nearest", line("s.new.0", y_m))
        assert choice.colours == ((Source(expected, "front_wide"), 1.0),) and choice.content == choice.colours[0][0]


def test_complete_lines_are_compared() -> None:
    # The line begins on one training line and continues on another.
    views = [*line("s.new.0", 0.0)[:4], *line("s.new.0", 8.0)[4:]]
    assert select("nearest", views).content.traversal_id == "s.day.1"
    assert AppearanceSelector(TRAINED_CAMERAS, "nearest").select(views[0]).content.traversal_id == "s.day.0"


def test_words_name_light_weather_or_a_traversal() -> None:
    views = line("s.new.0", 0.5)
    for word, expected in (("night", "s.night.0"), ("rain", "s.day.1"), ("clear", "s.day.0"), ("s.day.1", "s.day.1")):
        choice = select(word, views)
        assert choice.colours == ((Source(expected, "front_wide"), 1.0),)
        assert choice.content == Source(expected, "front_wide")


def test_edited_light_keeps_the_content() -> None:
    for views in (TRAINED, line("s.new.0", 0.5)):
        edited = select("night", views, everywhere=True)
        assert edited.colours[0][0].traversal_id == "s.night.0" and edited.content.traversal_id == "s.day.0"


def test_blocks_select_the_same_appearance_or_their_nearest() -> None:
    views = line("s.new.0", 5.0)
    parts = [
        trained_cameras([one for one in TRAINED if one.traversal_id != absent]) for absent in ("s.night.0", "s.day.0")
    ]

    def chosen(policy: str) -> list[str]:
        lines = DrivenLines(TRAINED_CAMERAS, views)
        selectors = [AppearanceSelector(cameras, policy, views, lines=lines) for cameras in parts]
        return [selector.select(views[0]).content.traversal_id for selector in selectors]

    assert chosen("nearest") == ["s.day.1", "s.night.0"]
    assert chosen("day") == ["s.day.1", "s.day.1"]
    assert chosen("s.day.0") == ["s.day.0", "s.night.0"]
    with pytest.raises(UsageError, match="'night'"):
        AppearanceSelector(parts[0], "night", views)
    # With the lines of the whole street, a block that was trained on all traversals selects the same.
    assert AppearanceSelector(TRAINED_CAMERAS, "nearest", views, lines=DrivenLines(TRAINED_CAMERAS, views)).select(
        views[0]
    ) == AppearanceSelector(TRAINED_CAMERAS, "nearest", views).select(views[0])


def test_mean_policy_averages_one_camera() -> None:
    choice = select("mean", line("s.new.0", 0.0), index=1)
    assert {source.camera for source, _ in choice.colours} == {"rear"} and len(choice.colours) == 3
    assert sum(weight for _, weight in choice.colours) == pytest.approx(1.0)


def test_sweep_blends_linearly_between_two_appearances() -> None:
    views = line("s.new.0", 0.5)
    selector = AppearanceSelector(TRAINED_CAMERAS, "sweep:day:night", views)
    shares = [selector.select(one).colours for one in views[::2]]
    assert [blend[1][1] for blend in shares] == pytest.approx(np.linspace(0.0, 1.0, 10).tolist())
    assert {blend[0][0].traversal_id for blend in shares} == {"s.day.0"}


def test_cameras_with_other_names_match_by_direction() -> None:
    views = line("s.new.0", 0.0, ("centre", "rear_view"))
    assert [select("nearest", views, index).content.camera for index in (0, 1)] == ["front_wide", "rear"]


def test_editing_the_light_changes_colours_only() -> None:
    street = trainer().street
    with torch.no_grad():
        # As after training, the content depends on the appearance.
        street.appearance.drives.mul_(20.0)
        day, night = (street.appearance(source) for source in street.appearance.sources)
        viewpoint = Painted()(view("s.day.0", 2)).viewpoint
        as_it_was, edited, other = (street(viewpoint, *pair) for pair in ((day, day), (night, day), (night, night)))
    assert torch.equal(as_it_was.depth_m, edited.depth_m) and torch.equal(as_it_was.alpha, edited.alpha)
    assert (as_it_was.rgb - edited.rgb).abs().max() > 0.01
    assert not torch.equal(as_it_was.depth_m, other.depth_m)


@pytest.mark.parametrize("policy", ["snow", "sweep:day", "sweep:day:snow", "sweep:a:b:c", ""])
def test_unknown_policies_are_refused(policy: str) -> None:
    with pytest.raises(UsageError):
        AppearanceSelector(TRAINED_CAMERAS, policy, TRAINED)


@given(st.floats(-1e3, 1e3), st.integers(1, 5), st.floats(4e5, 6e6))
def test_chamfer_is_symmetric_and_does_not_depend_on_the_origin(shift: float, count: int, origin: float) -> None:
    ours = np.column_stack((np.arange(5.0), np.zeros(5), np.zeros(5)))
    theirs = np.add(ours[:count], (0.0, shift, 0.0))
    assert chamfer_m(ours, theirs) == pytest.approx(chamfer_m(theirs, ours))
    assert chamfer_m(ours + origin, theirs + origin) == pytest.approx(chamfer_m(ours, theirs), abs=1e-6)
    assert chamfer_m(ours, ours) == 0.0


def test_densified_line_is_even_and_keeps_its_places() -> None:
    places = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [1.2, 0.0, 0.0], [1.2, 0.4, 0.0]])
    expected = [[0.0, 0, 0], [0.4, 0, 0], [0.8, 0, 0], [1.2, 0, 0], [1.2, 0, 0], [1.2, 0.4, 0]]
    np.testing.assert_allclose(densify_line(places), expected, atol=1e-12)
    np.testing.assert_array_equal(densify_line(places[:1]), places[:1])


def test_line_of_several_blocks_is_their_union() -> None:
    """Each block knows its own part of the line only."""
    halves = [
        trained_cameras([one for one in TRAINED if (one.world_SE3_camera.translation[0, 0] < 5.0) == first])
        for first in (True, False)
    ]
    views = line("s.new.0", 1.0)
    lines = DrivenLines([one for half in halves for one in half], views)
    chosen = {
        AppearanceSelector(half, "nearest", views, lines=lines).select(views[0]).content.traversal_id for half in halves
    }
    assert chosen == {"s.day.0"}
    reference = [
        chamfer_m(
            np.concatenate(
                [
                    densify_line(np.array([one.pose.translation[0] for one in views if one.camera == camera]))
                    for camera in CAMERAS
                ]
            ),
            np.concatenate(
                [densify_line(np.array(one.centre_m)) for half in halves for one in half if one.traversal_id == name]
            ),
        )
        for name in ("s.day.0", "s.night.0")
    ]
    assert reference[0] < reference[1] and lines.nearest(views[0], ["s.night.0", "s.day.0"]) == "s.day.0"
