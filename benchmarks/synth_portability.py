"""Files of a synthetic street under the instruction sets of different x86-64 processors, compared byte by byte.

``python -m benchmarks synth_portability [--preset tiny] [--scenes N]``. Each row writes the same recordings with a
restricted instruction set: in the compiler of the kernels (numba), numpy, BLAS, OpenCV or the C library, and in all of
them together. The error is the number of files that differ from those with all instructions; there may be none. Times
include start and compilation. Processors without x86-64 (arm64) are not measured.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from benchmarks.processors import INSTRUCTION_SETS, restricted
from benchmarks.report import Row, report


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns 1 if a file differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth_portability", description=__doc__)
    parser.add_argument("--preset", default="tiny", help="preset of `mirror synth` (default: tiny)")
    parser.add_argument("--scenes", type=int, help="number of scenes (default: all of the preset)")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        rows = _compare(Path(folder), arguments.preset, arguments.scenes)
        return report("synth_portability", {"instruction sets": rows}, errors="files that differ")


def _compare(folder: Path, preset: str, scenes: int | None) -> Iterator[Row]:
    expected: dict[str, str] = {}
    for name, features in INSTRUCTION_SETS.items():
        begin = time.perf_counter()
        files = _write_street(folder / name.replace(" ", "_"), preset, scenes, features)
        seconds = time.perf_counter() - begin
        expected = expected or files
        different = sorted(path for path in {*files, *expected} if files.get(path) != expected.get(path))
        for path in different:
            print(f"{name}: {path} differs", file=sys.stderr)
        size = f"{preset}, {len(files)} files"
        yield Row(name, size, 1e3 * seconds, len(different), unit="files", error_bar=0.5)


def _write_street(out: Path, preset: str, scenes: int | None, features: Mapping[str, str]) -> dict[str, str]:
    """Write a street in a process with these instructions; returns the SHA-256 of each file, by its path."""
    command = [sys.executable, "-m", "mirror.cli.main", "synth", "--preset", preset, "--out", str(out)]
    command += [] if scenes is None else ["--scenes", str(scenes)]
    environment = restricted(features, out.with_suffix(".cache"))
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }
