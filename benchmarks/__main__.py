"""``python -m benchmarks NAME [OPTIONS]`` runs one benchmark; without a name it lists them."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

from mirror.errors import ExitCode, MirrorError

_MACHINERY = ("__init__", "__main__", "report")


def names() -> list[str]:
    """The benchmarks, by name."""
    found = (path.stem for path in Path(__file__).parent.glob("*.py"))
    return sorted(name for name in found if name not in _MACHINERY and not name.startswith("_"))


def main(argv: list[str]) -> int:
    """Run the benchmark that is named."""
    if argv and argv[0] in names():
        try:
            code: int = importlib.import_module(f"benchmarks.{argv[0]}").main(argv[1:])
        except MirrorError as error:
            print(f"benchmarks {argv[0]}: {error}", file=sys.stderr)
            return ExitCode.COULD_NOT_RUN
        except BrokenPipeError:
            # The reader of our output went away (`| head`).
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return ExitCode.DONE
        return code
    print("usage: python -m benchmarks NAME [OPTIONS]; `--help` after a name explains it\n")
    for name in names():
        doc = importlib.import_module(f"benchmarks.{name}").__doc__ or ""
        print(f"{name:15} {doc.strip().splitlines()[0]}")
    if argv and argv[0] not in ("-h", "--help"):
        print(f"\nno benchmark is called {argv[0]!r}", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
