"""``python -m tests.peers [NAME ...]``: build each toolkit's environment, let it read its input, write its result.

A folder ``tests/peers/<name>`` holds ``requirements.txt``, optionally ``no_deps.txt`` (packages that are installed
without what they require), and ``read.py INPUT RESULT.json``. Environments and inputs lie in ``build/peers``; a toolkit
that cannot be installed is named, and its result stays.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.export.peers import INPUTS as EXPORTS
from tests.recordings.formats.peers import INPUTS as RECORDINGS
from tests.simulator.peers import INPUTS as SIMULATOR

INPUTS = {**RECORDINGS, **EXPORTS, **SIMULATOR}
HERE = Path(__file__).resolve().parent
BUILD = HERE.parents[1] / "build" / "peers"


def build(name: str) -> Path:
    """The Python of a toolkit's environment, made where it is absent."""
    environment = BUILD / name / "env"
    python, done = environment / "bin" / "python", environment / ".done"
    if not done.exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(environment)], check=True)
        pip = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, "-r", str(HERE / name / "requirements.txt")], check=True)
        if (HERE / name / "no_deps.txt").exists():
            subprocess.run([*pip, "--no-deps", "-r", str(HERE / name / "no_deps.txt")], check=True)
        done.touch()
    return python


def main(names: list[str]) -> int:
    """Make the results of some toolkits; without names, of those whose input `INPUTS` writes."""
    failed = []
    for name in names or sorted(INPUTS):
        folder = BUILD / name / "input"
        try:
            python = build(name)
            INPUTS[name](folder)
            subprocess.run([str(python), "read.py", str(folder), "result.json"], cwd=HERE / name, check=True)
        except subprocess.CalledProcessError as error:
            failed.append(name)
            print(f"{name}: {error}")
        else:
            print(f"{name}: tests/peers/{name}/result.json")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
