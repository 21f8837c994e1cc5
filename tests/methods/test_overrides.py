"""Settings that are overridden by name."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest
from pydantic import TypeAdapter

from hybridworldsim.methods.overrides import override_settings, settings_document
from hybridworldsim.model.settings import Settings
from mirror.errors import UsageError
from mirror_baselines import mtgs_style, omnire_style
from mirror_baselines.splatting.settings import Splatting


def test_override_changes_only_the_named_setting() -> None:
    usual = Settings(seed=3)
    words = {
        "depth_weight": "0.1",
        "refinement.max_anchors": "9000",
        "refinement.cells_m": "[2, 0.5]",
        "hybrid": "false",
    }
    expected = replace(
        usual,
        depth_weight=0.1,
        hybrid=False,
        refinement=replace(usual.refinement, max_anchors=9000, cells_m=(2.0, 0.5)),
    )
    assert override_settings(usual, words) == expected and override_settings(usual, {}) is usual


def test_a_bare_word_is_a_string() -> None:
    assert override_settings(Splatting(), {"weights.pixelwise": "l2"}).weights.pixelwise == "l2"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("depth_wight", "0.1", "no setting 'depth_wight'.*depth_weight"),
        ("refinement", "3", "no setting 'refinement'"),
        ("depth_weight", "much", "--set depth_weight: 'much'.*number"),
        ("depth_weight", "NaN", "NaN.*finite"),
        ("first_anchors", "1.5", "--set first_anchors: 1.5.*integer"),
        ("depth_weight", "-1", "-1.*0 or more"),
        ("refinement.cells_m", "[1.6, -0.4]", "-0.4.*0 or more"),
        ("hidden", "0", "hidden: 0.*1 or more"),
        ("seed", "3", "--seed"),
    ],
)
def test_unknown_settings_and_values_are_refused(name: str, value: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        override_settings(Settings(), {name: value})


def test_the_old_name_of_a_setting_is_accepted_and_stays_the_serialized_one() -> None:
    usual = Settings()
    renamed = override_settings(usual, {"refinement.max_anchors": "9000"})
    assert renamed.refinement.max_anchors == 9000
    assert override_settings(usual, {"refinement.most": "9000"}) == renamed
    document = json.loads(json.dumps(settings_document(renamed)))
    assert document["refinement"]["most"] == 9000 and "max_anchors" not in document["refinement"]
    assert TypeAdapter(Settings).validate_python(document) == renamed


def test_settings_document_is_unchanged() -> None:
    for settings in (Settings(seed=3), Splatting(), omnire_style.TUNED, mtgs_style.TUNED, mtgs_style.RELEASED):
        earlier = json.loads(json.dumps(asdict(settings)).replace('"max_anchors"', '"most"'))
        assert json.dumps(settings_document(settings)) == json.dumps(earlier)
