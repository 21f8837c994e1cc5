"""Weather words and plug-ins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.recordings import weather
from tests.wheels import install_plugins


def darkness(images: list[UInt8]) -> str:
    return "rain" if np.mean(images) < 100 else "bright"


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install_plugins(monkeypatch, tmp_path, weather.CLASSIFIERS.group, ("darkness", f"{__name__}:darkness"))


@pytest.mark.parametrize(
    ("word", "label"),
    [("Clouds", "clouds"), (" Light-Rain ", "rain"), ("MIST", "fog"), ("sleet", "snow"), ("Sunny", "clear")],
)
def test_words_are_converted_to_labels(word: str, label: str) -> None:
    assert weather.weather_label(word) == label


@pytest.mark.parametrize("word", [None, "", "banana"])
def test_unknown_words_give_none(word: str | None) -> None:
    assert weather.weather_label(word) is None


def test_every_label_is_a_known_word() -> None:
    assert [weather.weather_label(word) for word in weather.WEATHER] == list(weather.WEATHER)


@pytest.mark.usefixtures("plugins")
def test_plugin_classifies_images() -> None:
    assert weather.CLASSIFIERS.names() == ["darkness"]
    assert weather.classify_weather("darkness", [np.zeros((2, 2, 3), np.uint8)]) == "rain"


@pytest.mark.usefixtures("plugins")
def test_unknown_word_of_a_plugin_is_refused() -> None:
    with pytest.raises(UsageError, match="returned 'bright'"):
        weather.classify_weather("darkness", [np.full((2, 2, 3), 255, np.uint8)])


@pytest.mark.usefixtures("plugins")
def test_unknown_plugin_lists_the_installed_plugins() -> None:
    with pytest.raises(UsageError, match="expected one of darkness"):
        weather.classify_weather("clairvoyance", [])
