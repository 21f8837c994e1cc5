"""A wheel of plug-ins that were written for an earlier version loads, one of each kind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from tests.golden.plugins_before import ENTRY_POINTS
from tests.wheels import write_wheel

_USE = """
import sys
from pathlib import Path
from hybridworldsim.simulator.policy_registry import make_policy
from mirror.annotation.descriptions import DESCRIBERS
from mirror.annotation.registry import installed_annotator
from mirror.cli.main import main
from mirror.methods.registry import load_method, read_licence
from mirror.privacy import parse_choice
from mirror.recordings.weather import classify_weather

assert main(["verb-before", "--word", "1"]) == 2
assert main(["verb_before", "--word", "1"]) == 0
assert main(["ingest", "drive.walk", "--roi", "11.5778,48.1371", "--out", "dataset"]) == 0
assert load_method("grey_before").open(Path(), None) and read_licence("grey_before") == "MIT"
assert parse_choice("dark_before").make().threshold == 0.5
assert installed_annotator("car_before").open(None, {}, "cpu").name == "car_before"
assert DESCRIBERS.load("words_before").open(None, {}, "cpu").fingerprint == "words 1"
assert make_policy("coast_before").act(None).acceleration_mps2 == 0.0
assert classify_weather("fog_before", []) == "fog"
print("all used")
"""


def test_a_wheel_of_an_earlier_version_loads(tmp_path: Path) -> None:
    source = Path(__file__).with_name("plugins_before.py").read_text()
    entries = {group: [(name, f"plugins_before:{made}")] for group, (name, made) in ENTRY_POINTS.items()}
    wheel = write_wheel(tmp_path, "plugins_before", {"plugins_before.py": source}, entries)
    rows = ({"t": 1.7e9 + second, "lon": 11.5763 + 1e-4 * second, "lat": 48.1371} for second in range(30))
    (tmp_path / "drive.walk").write_text("".join(json.dumps(row) + "\n" for row in rows))
    done = subprocess.run(
        [sys.executable, "-c", _USE],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(wheel)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "the verb was called with --word 1" in done.stdout and "all used" in done.stdout


def test_import_paths_of_methods_of_an_earlier_version_go_on() -> None:
    moved = {
        "training.viewpoint": ("trainable.viewpoint", ("Source", "Viewpoint", "to_viewpoint")),
        "training.training_image": ("trainable.training_image", ("TrainingImage",)),
        "training.trainable_method": ("trainable.method", ("Rendering", "StepReport", "TrainableMethod")),
    }
    for old, (new, names) in moved.items():
        before, now = (import_module(f"hybridworldsim.{path}") for path in (old, new))
        assert all(getattr(before, name) is getattr(now, name) for name in names)
