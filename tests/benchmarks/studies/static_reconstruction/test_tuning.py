"""The tuning grid is the same for every method, and its cells change nothing else."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import ModuleType
from typing import Any

import pytest

from benchmarks.studies.static_reconstruction.choices import (
    AS_TUNED,
    BASELINE_CHOICES,
    OWN_CHOICES,
    baseline_name,
    choice,
)
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.methods import BASELINES, OURS, WIDER, trial, trials
from benchmarks.studies.static_reconstruction.scaling import scale_settings
from benchmarks.studies.static_reconstruction.tables import JobResult
from benchmarks.studies.static_reconstruction.tuning_tables import choices_table, grid_table
from hybridworldsim.model.settings import Rate, Settings
from mirror_baselines import mtgs_style, omnire_style
from mirror_baselines.splatting.scaling import scale_splatting

GRID = load_declaration().tuning
METHODS = ("ours", *(baseline_name(package) for package in BASELINES))


def test_every_method_tries_every_cell_and_baselines_their_released_choices() -> None:
    cells = [(rates, sizes) for rates in GRID.rates for sizes in GRID.sizes]
    beyond = {trial(name, *cell) for name, wider in WIDER.items() for cell in wider}
    back = {
        choice(name, change) for name, changes in ((OURS, OWN_CHOICES), *BASELINE_CHOICES.items()) for change in changes
    }
    assert set(trials()) == {trial(name, *cell) for name in METHODS for cell in cells} | beyond | back
    assert not beyond & {trial(name, *cell) for name in METHODS for cell in cells}


def test_the_middle_of_the_grid_is_the_hand_tuned_setting() -> None:
    assert scale_settings(Settings(), 1.0, 1.0) == Settings()
    for package in BASELINES:
        assert scale_splatting(package.BY_HAND, 1.0, 1.0) == package.BY_HAND


def test_a_cell_scales_only_rates_and_counts() -> None:
    settings, changed = omnire_style.BY_HAND, scale_splatting(omnire_style.BY_HAND, 2.0, 0.5)
    assert changed.rates.means == Rate(2.0 * settings.rates.means.first, 2.0 * settings.rates.means.last)
    assert changed.affine.first == pytest.approx(2.0 * settings.affine.first)
    assert changed.densification.most == settings.densification.most // 2
    back = scale_splatting(changed, 0.5, 2.0)
    assert back == settings
    # None stays None: a cell adds no learning rate.
    assert scale_splatting(mtgs_style.BY_HAND, 2.0, 1.0).exposure is None
    ours = scale_settings(Settings(), 0.5, 2.0)
    assert ours.refinement.max_anchors == 2 * Settings().refinement.max_anchors
    assert (
        replace(ours, rates=Settings().rates, refinement=Settings().refinement, first_anchors=Settings().first_anchors)
        == Settings()
    )


def test_our_method_has_no_more_trials_than_a_baseline() -> None:
    count = {name: sum(row.startswith(f"{name}+") for row in trials()) for name in METHODS}
    assert all(count["ours"] <= count[baseline_name(package)] for package in BASELINES)


@pytest.mark.parametrize("package", BASELINES)
def test_a_choice_sets_only_the_released_value(package: ModuleType) -> None:
    tuned_ones, released = (flat(asdict(settings)) for settings in (package.TUNED, package.RELEASED))
    for name, change in BASELINE_CHOICES[baseline_name(package)].items():
        changed = flat(asdict(change(package.TUNED)))
        # A missing rate has one name in place of two.
        differing = {key for key in changed.keys() | tuned_ones.keys() if changed.get(key) != tuned_ones.get(key)}
        assert bool(differing) == (name != AS_TUNED)
        assert all(changed.get(key) == released.get(key) for key in differing)


def flat(settings: dict[str, Any], under: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in settings.items():
        found |= flat(value, f"{under}{key}.") if isinstance(value, dict) else {f"{under}{key}": value}
    return found


def test_choices_are_shown_beside_the_tuned_ones() -> None:
    found = [
        JobResult(Job(choice("mtgs_style", name), GRID.scene, 0, GRID.core_minutes, 240),
                {"train PSNR": 28.0 + gain, "novel PSNR*": 17.0 - gain})
        for name, gain in ((AS_TUNED, 0.0), ("exposure", 0.25))
    ]  # fmt: skip
    assert "| mtgs_style+exposure | 28.25 | +0.25 | 16.75 | -0.25 |" in choices_table(found)
    assert choices_table(found[1:]) == "" == choices_table([])


def test_the_best_cell_of_each_method_is_marked() -> None:
    found = [
        JobResult(Job(trial("ours", rates, sizes), GRID.scene, 0, GRID.core_minutes, 240),
                {"train PSNR": 20.0 + rates, "novel PSNR*": 18.0 - sizes})
        for rates in GRID.rates for sizes in GRID.sizes
    ]  # fmt: skip
    text = grid_table(found, GRID)
    assert text.count("**") == 2
    best = f"**{20.0 + max(GRID.rates):.2f} / {18.0 - min(GRID.sizes):.2f}**"
    assert f"| {max(GRID.rates):g}, {min(GRID.sizes):g} | {best} |" in text
