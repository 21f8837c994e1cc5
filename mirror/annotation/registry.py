"""Annotators by name: entry points ``mirror.annotators``, or a file that the user names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mirror.annotation.protocol import Annotator, InstalledAnnotator
from mirror.plugins import PluginKind

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset

ANNOTATORS: Final = PluginKind("annotator", "mirror.annotators", "--annotator", "models")


def annotator_names() -> list[str]:
    """Return the names of the installed annotators, sorted."""
    return ANNOTATORS.names()


def installed_annotator(name: str) -> InstalledAnnotator:
    """Load an annotator.

    Args:
        name: name of an entry point, or ``FILE.py:OBJECT``.

    Raises:
        UsageError: there is no such annotator, it lacks a part of the interface, or one of its dependencies is
            missing.
    """
    annotator = ANNOTATORS.load(name)
    ANNOTATORS.require_parts(annotator, name, InstalledAnnotator)
    loaded: InstalledAnnotator = annotator
    return loaded


def open_annotator(
    name: str, installed: InstalledAnnotator, dataset: Dataset, settings: Mapping[str, str], device: str
) -> Annotator:
    """Open an annotator, and require that it can annotate; see `InstalledAnnotator.open`.

    Raises:
        UsageError: a setting is invalid, or what it returns lacks a part of the interface.
    """
    annotator = installed.open(dataset, settings, device)
    ANNOTATORS.require_parts(annotator, name, Annotator)
    return annotator


@dataclass(frozen=True)
class AnnotatorChoice:
    """An annotator that a worker can open.

    Attributes:
        name: name of an entry point, or ``FILE.py:OBJECT``.
        settings: values of its settings, as text.
        device: a torch device.
    """

    name: str
    settings: Mapping[str, str]
    device: str

    def open(self, dataset: Dataset) -> Annotator:
        """Open the annotator; see `open_annotator`."""
        return open_annotator(self.name, installed_annotator(self.name), dataset, self.settings, self.device)
