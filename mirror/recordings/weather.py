"""Weather of a drive: metadata words brought to the words of the tables, and plug-ins that look at pictures."""

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
    """The table's word for a source's word, or None where it says nothing that we know.

    Knows the words of `WEATHER`, their usual inflections, and the condition groups of OpenWeather, in any case.

    Args:
        word: what the source says.
    """
    if word is None:
        return None
    return _LABELS.get(" ".join(word.replace("_", " ").replace("-", " ").lower().split()))


def weather_plugins() -> list[str]:
    """Names of the installed plug-ins that tell the weather from pictures."""
    return sorted({entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)})


def classify_weather(plugin: str, pictures: Sequence[UInt8]) -> str:
    """Ask a plug-in.

    Args:
        plugin: the name of its entry point in the group ``mirror.weather``.
        pictures: (H, W, 3) RGB each, of one traversal.

    Returns:
        One of `WEATHER`.

    Raises:
        UsageError: no or more than one such plug-in is installed, or it answers with another word.
    """
    found = {entry.value: entry for entry in entry_points(group=ENTRY_POINT_GROUP, name=plugin)}
    if len(found) != 1:
        raise UsageError(
            f"{len(found)} weather plug-ins are named {plugin!r}",
            place=f"entry-point group {ENTRY_POINT_GROUP}",
            expected=f"one of {', '.join(weather_plugins()) or '(none is installed)'}",
            remedy="install the package that declares it, once",
        )
    look: WeatherPlugin = found.popitem()[1].load()
    answer = look(list(pictures))
    if answer not in WEATHER:
        raise UsageError(f"the weather plug-in {plugin!r} answered {answer!r}", expected=f"one of {', '.join(WEATHER)}")
    return answer
