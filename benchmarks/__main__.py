"""``python -m benchmarks NAME [OPTIONS]`` runs one benchmark; without a name it lists them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from mirror.command import run_command
from mirror.errors import ExitCode
from mirror.stops import run_process

_MACHINERY = ("__init__", "__main__", "report")


def names() -> list[str]:
    """The benchmarks, by name."""
    found = (path.stem for path in Path(__file__).parent.glob("*.py"))
    return sorted(name for name in found if name not in _MACHINERY and not name.startswith("_"))


def main(argv: list[str]) -> int:
    """Run the benchmark that is named."""
    if argv and argv[0] in names():
        return run_command(
            f"benchmarks {argv[0]}", lambda: importlib.import_module(f"benchmarks.{argv[0]}").main(argv[1:])
        )
    return run_command("benchmarks", lambda: _listed(argv))


def _listed(argv: list[str]) -> int:
    print("usage: python -m benchmarks NAME [OPTIONS]; `--help` after a name explains it\n")
    for name in names():
        doc = importlib.import_module(f"benchmarks.{name}").__doc__ or ""
        print(f"{name:15} {doc.strip().splitlines()[0]}")
    if argv and argv[0] not in ("-h", "--help"):
        print(f"\nno benchmark is called {argv[0]!r}", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(run_process("python -m benchmarks", lambda: main(sys.argv[1:])))
