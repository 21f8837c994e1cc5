"""Refuses retired words: ``python docs/check_words.py``; the glossary's table lists them (docs/glossary.md)."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACES = (
    "README.md",
    "CONTRIBUTING.md",
    "docs/glossary.md",
    "docs/architecture.md",
    "docs/performance.md",
    "docs/loading.md",
    "docs/conventions.md",
    "docs/rules.md",
    "mirror/dataset",
    "mirror/integrity",
    "mirror/geometry",
    "tests/dataset",
    "tests/dataset_split",
    "tests/dataset_stats",
    "tests/integrity",
    "tests/geometry",
    "tests/test_docstring_snippets.py",
    "docs/recordings.md",
    "docs/schema.md",
    "docs/weights.md",
    "mirror/errors.py",
    "mirror/recordings",
    "mirror/schema",
    "mirror/weights",
    "tests/fuzz",
    "tests/recordings",
    "tests/schema",
    "tests/weights",
    "benchmarks/synth.py",
    "benchmarks/synth_detectors",
    "benchmarks/synth_matching",
    "docs/images",
    "docs/synth.md",
    "docs/truth.md",
    "mirror/synth",
    "tests/synth",
    "tests/synth_detectors",
    "tests/synth_driving",
    "tests/synth_fleet",
    "tests/synth_light",
    "tests/synth_matching",
    "tests/synth_people",
    "tests/synth_plants",
    "tests/synth_render",
    "tests/synth_rigs",
    "tests/synth_road_users",
    "tests/synth_street",
    "tests/synth_street_houses",
    "tests/synth_textures",
    "tests/synth_truth",
    "baselines/hybridworldsim/__init__.py",
    "baselines/hybridworldsim/methods",
    "baselines/hybridworldsim/model",
    "baselines/hybridworldsim/training",
    "baselines/mirror_baselines",
    "benchmarks",
    "docs/reconstruction.md",
    "docs/results.md",
    "tests/baselines",
    "tests/baselines_splatting",
    "tests/benchmarks",
    "tests/real",
    "tests/static_reconstruction",
    "tests/street",
    "tests/training",
    "baselines/hybridworldsim/kernels",
    "baselines/hybridworldsim/mvs",
    "baselines/hybridworldsim/rasterizer",
    "baselines/hybridworldsim/stationary.py",
    "docs/initialisation.md",
    "docs/rasterizer.md",
    "docs/rasterizer_training.md",
    "examples",
    "tests/examples",
    "tests/mvs_networks",
    "tests/rasterizer",
    "leaderboard",
    "tests/leaderboard",
    "mirror/evaluation",
    "tests/evaluation",
)
"""Where no retired word stands any more. A folder is added here when its words are swept."""
_FLOORS = "baselines/mirror_baselines"
ALLOWED = (
    ("mirror/dataset/layout.py", "pictures"),  # a key of manifest.json
    ("mirror/integrity/rules/images.py", "pictures"),
    ("mirror/integrity/summary.py", "pictures"),  # a key of manifest.json and of mirror info --json
    ("tests/integrity/clean.py", "pictures"),
    ("tests/integrity/edits_of_scenes.py", "pictures"),
    ("mirror/recordings/boreas.py", "pictures"),  # the value of the column `method`: it is in tables
    ("mirror/schema/tables.py", "picture"),  # the documentation of columns: it is in the bytes of every table
    ("mirror/schema/tables.py", "pictures"),
    ("docs/schema.md", "picture"),  # generated from mirror/schema/tables.py
    ("docs/schema.md", "pictures"),
    ("mirror/schema/documents.py", "pictures"),  # a key of manifest.json
    ("docs/recordings.md", "pictures"),  # the option `mirror check --pictures`
    ("benchmarks/synth_detectors/benchmark.py", "pictures"),  # the old name of the option --images
    ("mirror/synth/on_demand/png.py", "picture"),  # a note in the bytes of every rendered PNG
    ("mirror/synth/truth/tables.py", "picture"),  # the documentation of columns: it is in the bytes of every table
    ("mirror/synth/truth/tables.py", "pictures"),
    ("mirror/synth/writing/journal.py", "pictures"),  # a key of synth.json
    ("mirror/synth/writing/recordings.py", "pictures"),
    ("baselines/hybridworldsim/methods/static.py", "pictures"),  # a key of run.json and of mirror reconstruct --json
    ("baselines/hybridworldsim/model/visibility_cache.py", "pictures"),  # a key of checkpoints
    ("baselines/hybridworldsim/training/run/folder.py", "pictures"),  # a key of run.json and a folder of a run
    (f"{_FLOORS}/mean_color/submission.py", "pictures"),  # the text of a submission's manifest
    (f"{_FLOORS}/nearest_frame/submission.py", "picture"),
    (f"{_FLOORS}/nearest_frame/submission.py", "pictures"),
    ("benchmarks/studies/static_reconstruction/README.md", "rivals"),  # a row of published records
    ("benchmarks/studies/static_reconstruction/choices.py", "rivals"),
    ("benchmarks/studies/static_reconstruction/declaration.py", "pictures"),  # a key of the hashed declaration
    ("benchmarks/studies/static_reconstruction/run_job.py", "pictures"),  # a key of published records
    ("benchmarks/studies/static_reconstruction/truth/exact_street.py", "pictures"),
    ("benchmarks/studies/static_reconstruction/truth/lighting.py", "pictures"),
    ("benchmarks/studies/static_reconstruction/truth/tables.py", "pictures"),
    ("docs/reconstruction.md", "pictures"),  # a folder of a run
    ("leaderboard/mirror_leaderboard/entry.py", "pictures"),  # a folder of a board
    ("tests/real/test_reconstruction.py", "pictures"),  # a key of mirror reconstruct --json
    ("tests/static_reconstruction/test_records.py", "pictures"),  # a key of published records
    ("tests/static_reconstruction/test_tables.py", "pictures"),
    ("tests/training/test_loop.py", "pictures"),  # a key of run.json and a folder of a run
)
"""The end of a file's path, and a word that stays in that file because it is serialized or is an option."""


def retired() -> list[str]:
    """The words of the glossary's table."""
    table = (ROOT / "docs" / "glossary.md").read_text().partition("## Retired words")[2]
    cells = re.findall(r"^\| ([^|]+) \|", table, re.M)[1:]
    return [word for cell in cells if not cell.startswith("---") for word in cell.split(", ")]


def main() -> int:
    """Print each place with a retired word; 1 if there is one."""
    words = re.compile(rf"\b({'|'.join(map(re.escape, retired()))})\b")
    hits = 0
    for place in PLACES:
        path = ROOT / place
        files = [path] if path.is_file() else sorted([*path.rglob("*.py"), *path.rglob("*.md")])
        for file in files:
            text = file.read_text()
            if file.name == "glossary.md":
                text = text.partition("## Retired words")[0]
            for number, line in enumerate(text.splitlines(), start=1):
                for word in words.findall(line):
                    if any(file.match(name) and word == allowed for name, allowed in ALLOWED):
                        continue
                    hits += 1
                    print(f"{file.relative_to(ROOT)}:{number}: {word!r} is retired: see docs/glossary.md")
    return int(hits > 0)


if __name__ == "__main__":
    sys.exit(main())
