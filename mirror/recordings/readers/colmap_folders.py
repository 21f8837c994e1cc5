"""The folders of COLMAP models in a recording, and the choice among several of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from mirror.recordings.opening import find_file
from mirror.recordings.paths import natural_key
from mirror.recordings.readers.colmap_model import count_images

# Folders of models, in the order in which they are looked for; a star is a folder with a number.
_FOLDERS: Final = ("sparse/*", "sparse", "colmap/sparse/*", "colmap", "")


def model_folders(path: Path) -> dict[str, int]:
    """Count the images of each model by its folder, the largest model first.

    The folders are those at the first of the places of models.

    The mapper of COLMAP writes a model for each part of the images that it could not connect: ``sparse/0``,
    ``sparse/1`` ... One model alone is not counted (0).
    """
    for place in _FOLDERS:
        folders = [place]
        if place.endswith("/*"):
            parent = place.removesuffix("/*")
            children = (path / parent).iterdir() if (path / parent).is_dir() else ()
            names = sorted((child.name for child in children if child.name.isdecimal()), key=natural_key)
            folders = [f"{parent}/{name}" for name in names]
        found = [folder for folder in folders if _holds_model(path, folder)]
        if len(found) > 1:
            counts = {folder: count_images(path, folder) for folder in found}
            return dict(sorted(counts.items(), key=lambda item: -item[1]))
        if found:
            return {found[0]: 0}
    return {}


def _holds_model(path: Path, folder: str) -> bool:
    prefix = f"{folder}/" if folder else ""
    return any(
        find_file(path, f"{prefix}cameras{suffix}") and find_file(path, f"{prefix}images{suffix}")
        for suffix in (".bin", ".txt")
    )


def name_choice(models: Mapping[str, int], folder: str) -> tuple[str, ...]:
    """Say for `mirror info` and `mirror ingest` that a folder has several models."""
    if len(models) < 2:
        return ()
    listed = ", ".join(f"{name} ({count} images)" for name, count in models.items())
    return (f"several models of COLMAP: {listed}; {folder} is read, `--option model=FOLDER` reads another",)
