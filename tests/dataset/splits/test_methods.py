"""The methods on traversals made up here, held against brute force."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.dataset.splits import by_condition, by_list, by_scene, novel_traversal
from mirror.dataset.splits.candidates import Candidate
from mirror.dataset.splits.leaks import Tie, find_leaks
from mirror.dataset.splits.units import connected_components, members_by_component, seeded_rank
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import ByCondition, ByList, ByScene, LightAndWeather, NovelTraversal
from tests.draws import draws


def made(*pairs: tuple[str, str], light: str = "day", weather: str = "clear") -> list[Candidate]:
    """Traversals of (scene, drive), one behind the other."""
    return [
        Candidate(f"{scene}.{drive}.{number}", scene, drive, f"car_{drive}", number * 100, number * 100 + 50, light,
                  weather, "0" * 64)
        for number, (scene, drive) in enumerate(pairs)
    ]  # fmt: skip


def drive_ties(traversals: list[Candidate], *, scenes: bool = False) -> list[Tie]:
    groups: dict[tuple[str, str], list[str]] = {}
    for item in traversals:
        groups.setdefault(("drive", item.drive_id), []).append(item.traversal_id)
        if scenes:
            groups.setdefault(("scene", item.scene_id), []).append(item.traversal_id)
    return [
        Tie(kind, tuple(sorted(own)), f"are of one {kind}, {name}")  # type: ignore[arg-type]
        for (kind, name), own in groups.items()
        if len(own) > 1
    ]


def counts(roles: dict[str, str], scene: str) -> dict[str, int]:
    own = [role for key, role in roles.items() if key.startswith(f"{scene}.")]
    return {role: own.count(role) for role in set(own)}


def test_paper_default_is_four_and_one() -> None:
    traversals = made(*[("a", f"d{k}") for k in range(7)])
    found = novel_traversal.assign(traversals, [], NovelTraversal(), 0)
    assert counts(dict(found.roles), "a") == {"train": 4, "held_out": 1, "unused": 2}
    assert found.left_out == {}


def test_order_of_ingest_and_other_traversals_do_not_matter() -> None:
    traversals = made(*[("a", f"d{k}") for k in range(9)])
    one = novel_traversal.assign(traversals, [], NovelTraversal(), 3).roles
    assert novel_traversal.assign(traversals[::-1], [], NovelTraversal(), 3).roles == one
    # A scene with other drives elsewhere changes nothing here.
    more = [*traversals, *made(*[("b", f"e{k}") for k in range(5)])]
    again = novel_traversal.assign(more, [], NovelTraversal(), 3).roles
    assert {key: again[key] for key in one} == one
    others = [novel_traversal.assign(traversals, [], NovelTraversal(), seed).roles for seed in range(20)]
    assert len({tuple(sorted(other.items())) for other in others}) > 5


def test_seeded_choice_is_fair() -> None:
    traversals = made(*[("a", f"d{k}") for k in range(5)])
    held = [
        next(key for key, role in novel_traversal.assign(traversals, [], NovelTraversal(), seed).roles.items()
             if role == "held_out")
        for seed in range(1000)
    ]  # fmt: skip
    # Binomial(1000, 1/5): 200 with a standard deviation of 12.6.
    assert all(140 < held.count(item.traversal_id) < 260 for item in traversals)


def test_both_passes_of_a_drive_stand_in_one_role() -> None:
    traversals = made(("a", "twice"), ("a", "twice"), ("a", "d1"), ("a", "d2"), ("a", "d3"))
    for seed in range(30):
        roles = novel_traversal.assign(traversals, drive_ties(traversals), NovelTraversal(), seed).roles
        assert counts(dict(roles), "a") == {"train": 4, "held_out": 1}
        assert {roles["a.twice.0"], roles["a.twice.1"]} == {"train"}


def test_exact_fit_is_found_where_the_seed_order_overshoots() -> None:
    traversals = made(("a", "twice"), ("a", "twice"), ("a", "thrice"), ("a", "thrice"), ("a", "thrice"), ("a", "one"))
    for seed in range(20):
        roles = novel_traversal.assign(traversals, drive_ties(traversals), NovelTraversal(train=3), seed).roles
        assert roles["a.one.5"] == "held_out"
        assert counts(dict(roles), "a") == {"train": 3, "held_out": 1, "unused": 2}


def test_too_few_traversals_leave_the_scene_out() -> None:
    traversals = made(*[("a", f"d{k}") for k in range(4)], *[("b", f"e{k}") for k in range(5)])
    found = novel_traversal.assign(traversals, [], NovelTraversal(), 0)
    assert set(found.left_out) == {"a"}
    assert counts(dict(found.roles), "a") == {"unused": 4}


def test_impossible_names_two_traversals() -> None:
    traversals = made(*[("a", "d")] * 5)
    with pytest.raises(DatasetError) as caught:
        novel_traversal.assign(traversals, drive_ties(traversals), NovelTraversal(), 0)
    assert "a.d.0 and a.d.1 are of one drive, d" in str(caught.value)


def test_impossible_across_scenes_names_two_traversals() -> None:
    # Each pair of the three drives meets in a scene: two of them would have to be on the same side.
    traversals = made(("a", "x"), ("a", "y"), ("b", "y"), ("b", "z"), ("c", "z"), ("c", "x"))
    with pytest.raises(DatasetError, match=r"scene \w cannot be divided") as caught:
        novel_traversal.assign(traversals, drive_ties(traversals), NovelTraversal(train=1), 0)
    assert "are of one drive" in str(caught.value)


drives = st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("uvwxyz")), min_size=1, max_size=14)


@settings(max_examples=draws(150), deadline=None)
@given(drives, st.integers(1, 2), st.integers(1, 2), st.integers(0, 3))
def test_novel_traversal_against_brute_force(
    pairs: list[tuple[str, str]], train: int, held_out: int, seed: int
) -> None:
    traversals = made(*pairs)
    parameters = NovelTraversal(train=train, held_out=held_out)
    scenes = {scene: [pair for pair in pairs if pair[0] == scene] for scene, _ in pairs}
    full = {scene: own for scene, own in scenes.items() if len(own) >= train + held_out}
    names = sorted({drive for _, drive in pairs})

    def works(held: tuple[str, ...]) -> bool:
        number = [sum(drive in held for _, drive in own) for own in full.values()]
        return all(n >= held_out and len(own) - n >= train for n, own in zip(number, full.values()))

    possible = any(works(held) for size in range(len(names) + 1) for held in combinations(names, size))
    ties = drive_ties(traversals)
    try:
        found = novel_traversal.assign(traversals, ties, parameters, seed)
    except DatasetError:
        assert not possible
        return
    assert possible
    assert set(found.left_out) == set(scenes) - set(full)
    assert find_leaks(ties, found.roles) == []
    for scene in scenes:
        own = counts(dict(found.roles), scene)
        assert own.get("train", 0) == (train if scene in full else 0)
        assert own.get("held_out", 0) == (held_out if scene in full else 0)


def test_by_scene_shares() -> None:
    traversals = made(*[(f"s{k:02}", f"d{k}") for k in range(20)])
    roles = by_scene.assign(traversals, drive_ties(traversals, scenes=True), ByScene(), 0).roles
    values = list(roles.values())
    assert (values.count("train"), values.count("val"), values.count("test")) == (14, 3, 3)


def test_by_scene_keeps_tied_scenes_together() -> None:
    # One drive passes a, b and c; the others are free.
    pairs = [("a", "x"), ("b", "x"), ("c", "x"), *[(f"s{k}", f"d{k}") for k in range(7)]]
    traversals = made(*pairs)
    for seed in range(10):
        roles = by_scene.assign(traversals, drive_ties(traversals, scenes=True), ByScene(), seed).roles
        assert len({roles["a.x.0"], roles["b.x.1"], roles["c.x.2"]}) == 1
        assert set(roles.values()) == {"train", "val", "test"}


def test_by_scene_that_is_one_piece_is_refused() -> None:
    traversals = made(("a", "x"), ("b", "x"), ("c", "x"))
    with pytest.raises(DatasetError, match=r"a\.x\.0 and b\.x\.1 are of one drive, x"):
        by_scene.assign(traversals, drive_ties(traversals, scenes=True), ByScene(), 0)


def test_by_scene_with_fewer_scenes_than_roles() -> None:
    traversals = made(("a", "x"), ("b", "y"))
    with pytest.raises(UsageError, match="cannot fill the roles train, val, test"):
        by_scene.assign(traversals, [], ByScene(), 0)
    roles = by_scene.assign(traversals, [], ByScene(train=0.5, val=0, test=0.5), 0).roles
    assert sorted(roles.values()) == ["test", "train"]


def test_by_condition_tests_what_fits_and_separates_drives() -> None:
    day = made(("a", "d0"), ("a", "d1"))
    night = made(("a", "n0"), light="night")
    rain = made(("a", "r0"), weather="rain")
    mixed = [*made(("b", "m")), *made(("c", "m"), light="night")]
    traversals = [*day, *night, *rain, *mixed]
    parameters = ByCondition(
        train=(LightAndWeather(light="day"),), test=(LightAndWeather(light="night"), LightAndWeather(weather="rain"))
    )
    found = by_condition.assign(traversals, drive_ties(traversals), parameters)
    assert found.roles == {
        "a.d0.0": "train", "a.d1.1": "train", "a.n0.0": "test", "a.r0.0": "test", "b.m.0": "unused", "c.m.0": "test",
    }  # fmt: skip
    assert found.left_out == {"b.m.0": "b.m.0 and c.m.0, which is tested on, are of one drive, m"}


@pytest.mark.parametrize(
    ("pairs", "message"),
    [([("day", "clear")], "no traversal has light=night"), ([("night", "clear")], "no traversal has light=day")],
)
def test_by_condition_without_a_role(pairs: list[tuple[str, str]], message: str) -> None:
    traversals = [item for light, weather in pairs for item in made(("a", "d"), light=light, weather=weather)]
    parameters = ByCondition(train=(LightAndWeather(light="day"),), test=(LightAndWeather(light="night"),))
    with pytest.raises(DatasetError, match=message):
        by_condition.assign(traversals, [], parameters)


def test_by_condition_that_only_one_drive_could_fill() -> None:
    traversals = [*made(("a", "m")), *made(("b", "m"), light="night")]
    parameters = ByCondition(train=(LightAndWeather(light="day"),), test=(LightAndWeather(light="night"),))
    with pytest.raises(DatasetError, match=r"a\.m\.0 and b\.m\.0"):
        by_condition.assign(traversals, drive_ties(traversals), parameters)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=12))
def test_components_against_repeated_merging(edges: list[tuple[int, int]]) -> None:
    members = [str(k) for k in range(10)]
    groups = [{member} for member in members]
    for a, b in edges:
        both = [group for group in groups if str(a) in group or str(b) in group]
        groups = [group for group in groups if group not in both] + [set().union(*both)]
    found = members_by_component(connected_components(members, [(str(a), str(b)) for a, b in edges]))
    assert {frozenset(own) for own in found.values()} == {frozenset(group) for group in groups}
    assert all(name == own[0] for name, own in found.items())


def test_rank_differs_by_seed_and_name() -> None:
    ranks = {seeded_rank(seed, name) for seed, name in product(range(10), "abcdefghij")}
    assert len(ranks) == 100


def test_poses_alone_are_neither_trained_on_nor_held_out_beside_images() -> None:
    imaged = made(*(("a", f"drive{k}") for k in range(3)))
    blind = [replace(item, has_images=False) for item in made(*(("a", f"blind{k}") for k in range(3)))]
    parameters = NovelTraversal(train=2, held_out=1)
    for seed in range(20):
        roles = novel_traversal.assign([*imaged, *blind], [], parameters, seed).roles
        assert {roles[item.traversal_id] for item in blind} == {"unused"}
        assert sorted(roles[item.traversal_id] for item in imaged) == ["held_out", "train", "train"]
    alone = novel_traversal.assign(blind, [], parameters, 0).roles
    assert sorted(alone.values()) == ["held_out", "train", "train"]


def test_listed_traversals_are_held_out_and_all_others_of_their_scenes_trained_on() -> None:
    traversals = made(("a", "d1"), ("a", "d2"), ("a", "d3"), ("b", "d4"))
    roles = by_list.assign(traversals, [], ByList(held_out=("a.d2.1",))).roles
    assert roles == {"a.d1.0": "train", "a.d2.1": "held_out", "a.d3.2": "train", "b.d4.3": "unused"}
    some = by_list.assign(traversals, [], ByList(held_out=("a.d2.1",), train=("a.d3.2", "b.d4.3"))).roles
    assert some == {"a.d1.0": "unused", "a.d2.1": "held_out", "a.d3.2": "train", "b.d4.3": "train"}


@pytest.mark.parametrize(
    ("held_out", "train", "problem"),
    [
        (("a.d9.9",), None, "no traversal is called 'a.d9.9'"),
        (("a.d3.2",), ("a.d9.9",), "no traversal is called 'a.d9.9'"),
        (("a.d3.2",), ("a.d3.2",), "a.d3.2 is in both lists"),
        (("b.d4.3",), None, "b.d4.3 is held out of scene b, which has no traversal to train on"),
        (("a.d1.0",), None, "a.d1.1 would be trained on and a.d1.0 held out, but they are of one drive, d1"),
    ],
)
def test_lists_that_name_nothing_or_leak_are_refused(
    held_out: tuple[str, ...], train: tuple[str, ...] | None, problem: str
) -> None:
    traversals = made(("a", "d1"), ("a", "d1"), ("a", "d3"), ("b", "d4"))
    with pytest.raises(DatasetError, match=problem):
        by_list.assign(traversals, drive_ties(traversals), ByList(held_out=held_out, train=train))
