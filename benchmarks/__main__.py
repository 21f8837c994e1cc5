"""``python -m benchmarks NAME [OPTIONS]`` runs one benchmark; without a name it lists them."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path
from typing import Final

from mirror.command import run_command
from mirror.errors import ExitCode
from mirror.stops import run_process

_HERE: Final = Path(__file__).parent
_NO_BENCHMARKS: Final = ("__main__", "processors", "report", "studies")
_STUDIES: Final = "studies"
FORMER_NAMES: Final = {"reconstruction": "static_reconstruction", "colour_attacks": "attacks"}
"""Names that are still accepted, and what they are called now."""


def modules() -> dict[str, str]:
    """Return the module of each benchmark, by the benchmark's name; a package has its `main` in its module `benchmark`.

    Every study is a package; the modules beside them are what studies share.
    """
    found = {}
    for prefix, folder in (("benchmarks", _HERE), (f"benchmarks.{_STUDIES}", _HERE / _STUDIES)):
        for module in pkgutil.iter_modules([str(folder)]):
            is_benchmark = module.ispkg if folder.name == _STUDIES else module.name not in _NO_BENCHMARKS
            if is_benchmark and not module.name.startswith("_"):
                found[module.name] = f"{prefix}.{module.name}"
    return dict(sorted(found.items()))


def main(argv: list[str]) -> int:
    """Run the benchmark that is named."""
    name = FORMER_NAMES.get(argv[0], argv[0]) if argv else ""
    if name in modules():
        return run_command(f"benchmarks {name}", lambda: _run(modules()[name], argv[1:]))
    return run_command("benchmarks", lambda: _list(argv))


def _run(name: str, argv: list[str]) -> int:
    module = importlib.import_module(name)
    if hasattr(module, "__path__"):
        module = importlib.import_module(f"{name}.benchmark")
    code: int = module.main(argv)
    return code


def _list(argv: list[str]) -> int:
    print("usage: python -m benchmarks NAME [OPTIONS]; `--help` after a name explains it\n")
    for name, module in modules().items():
        doc = importlib.import_module(module).__doc__ or ""
        print(f"{name:22} {doc.strip().splitlines()[0]}")
    if argv and argv[0] not in ("-h", "--help"):
        print(f"\nno benchmark is called {argv[0]!r}", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(run_process("python -m benchmarks", lambda: main(sys.argv[1:])))
