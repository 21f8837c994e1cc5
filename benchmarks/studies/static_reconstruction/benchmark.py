"""Compares static reconstruction by our method with 3DGS, MTGS-style and OmniRe-style, at equal cost."""

from __future__ import annotations

from collections.abc import Sequence

import tyro

from benchmarks.studies.static_reconstruction.arguments import Arguments


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks static_reconstruction")

    # Imported late, because torch and all methods are slow to import for `--help`.
    from benchmarks.studies.static_reconstruction.declaration import load_declaration
    from benchmarks.studies.static_reconstruction.verbs import VERBS

    return VERBS[arguments.what](arguments, load_declaration())


if __name__ == "__main__":
    raise SystemExit(main([]))
