"""Weather of a drive: from words of its metadata, or from plug-ins that classify images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.plugins import PluginKind

CLASSIFIERS: Final = PluginKind("weather plug-in", "mirror.weather", "--weather-from", "all", takes_files=False)
WEATHER: Final = ("clear", "clouds", "rain", "snow", "fog")

WeatherPlugin: TypeAlias = Callable[[list[UInt8]], str]

_WORDS: Final = {
    "clear": ("clear", "sun", "sunny", "fair", "fine", "dry", "clear sky", "mostly clear", "mainly clear"),
    "clouds": (
        "clouds",
        "cloud",
        "cloudy",
        "overcast",
        "partly cloudy",
        "mostly cloudy",
        "few clouds",
        "broken clouds",
    ),
    "rain": ("rain", "rainy", "raining", "light rain", "heavy rain", "drizzle", "shower", "showers", "thunderstorm"),
    "snow": ("snow", "snowy", "snowing", "light snow", "heavy snow", "sleet", "blizzard", "hail"),
    "fog": ("fog", "foggy", "mist", "misty", "haze", "hazy", "smoke", "dust", "sand"),
}
_LABELS: Final = {word: label for label, words in _WORDS.items() for word in words}


def weather_label(word: str | None) -> str | None:
    """Convert a source's word to one of `WEATHER`; None if the word is unknown.

    Known are the words of `WEATHER`, their usual inflections, and the condition groups of OpenWeather, in any case.

    Args:
        word: the source's word; None: the source has none.
    """
    if word is None:
        return None
    return _LABELS.get(" ".join(word.replace("_", " ").replace("-", " ").lower().split()))


def classify_weather(plugin: str, images: Sequence[UInt8]) -> str:
    """Classify the weather of a traversal with a plug-in.

    Args:
        plugin: the name of its entry point in the group ``mirror.weather``.
        images: images of one traversal, each (H, W, 3) uint8 RGB.

    Returns:
        One of `WEATHER`.

    Raises:
        UsageError: no or several plug-ins have this name, or the plug-in returns another word.
    """
    classify: WeatherPlugin = CLASSIFIERS.load(plugin)
    weather = classify(list(images))
    if weather not in WEATHER:
        raise UsageError(
            f"the weather plug-in {plugin!r} returned {weather!r}", expected=f"one of {', '.join(WEATHER)}"
        )
    return weather
