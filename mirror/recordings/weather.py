"""Weather of a drive: from words of its metadata, or from plug-ins that classify images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Final, TypeAlias

from mirror.arrays import UInt8
from mirror.errors import UsageError

ENTRY_POINT_GROUP: Final = "mirror.weather"
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


def weather_plugins() -> list[str]:
    """Names of the installed plug-ins that classify the weather in images."""
    return sorted({entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)})


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
    entries = {entry.value: entry for entry in entry_points(group=ENTRY_POINT_GROUP, name=plugin)}
    if len(entries) != 1:
        raise UsageError(
            f"{len(entries)} weather plug-ins are named {plugin!r}",
            place=f"entry-point group {ENTRY_POINT_GROUP}",
            expected=f"one of {', '.join(weather_plugins()) or '(none is installed)'}",
            remedy="install the package that declares it, once",
        )
    classify: WeatherPlugin = entries.popitem()[1].load()
    weather = classify(list(images))
    if weather not in WEATHER:
        raise UsageError(
            f"the weather plug-in {plugin!r} returned {weather!r}", expected=f"one of {', '.join(WEATHER)}"
        )
    return weather
