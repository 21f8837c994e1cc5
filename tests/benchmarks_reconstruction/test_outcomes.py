"""Which outcomes count: those of the declaration and of the settings that are committed."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.declared import declared
from benchmarks.studies.static_reconstruction.job import OUTCOMES, TRUTH, Job, read_outcome
from benchmarks.studies.static_reconstruction.methods import OURS, entries
from benchmarks.studies.static_reconstruction.queue import is_done
from benchmarks.studies.static_reconstruction.tables import outcomes
from benchmarks.studies.static_reconstruction.verbs import VERBS
from mirror.errors import DatasetError, ExitCode

JOB = Job(OURS, "guangzhou-urban", 1, 10.0, 240)
MEANS = {"psnr": 30.0, "psnr_cc": 20.0, "ssim": 0.8, "st_lpips": 0.1}


def written(folder: Path, of: Job = JOB, **changes: Any) -> Path:
    document = {
        "job": asdict(of), "declaration": declared().hash, "dataset_hash": "d", "core_s": 600.0,
        "settings": entries()[of.entry].settings(of.seed),
        "model_bytes": 5_000_000, "gaussians": 7, "steps": 3, "means": {"training": MEANS, "novel": MEANS},
        "oracle": MEANS, "scores": [{"path": "a", "psnr": 30.0}],
    }  # fmt: skip
    path = folder / OUTCOMES / f"{of.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**document, **changes}))
    return path


def test_an_outcome_of_the_present_counts(tmp_path: Path) -> None:
    assert read_outcome(written(tmp_path)) is not None
    assert is_done(JOB, tmp_path) and [one.job.entry for one in outcomes(tmp_path)] == [OURS]
    assert not is_done(replace(JOB, seed=2), tmp_path)


@pytest.mark.parametrize(
    "changes",
    [
        {"declaration": "another"},
        {"settings": {**entries()[OURS].settings(1), "structure_weight": 0.5}},
        {"settings": entries()[OURS].settings(0)},
        {"settings": None},
        {"job": {**asdict(JOB), "entry": "a row that is gone"}},
    ],
)
def test_an_outcome_of_something_else_does_not(changes: dict[str, Any], tmp_path: Path) -> None:
    written(tmp_path, **changes)
    assert not is_done(JOB, tmp_path) and outcomes(tmp_path) == []


def test_outcomes_of_two_datasets_are_not_put_together(tmp_path: Path) -> None:
    written(tmp_path)
    written(tmp_path, replace(JOB, seed=2), dataset_hash="another")
    with pytest.raises(DatasetError, match="outcomes of 2 datasets"):
        outcomes(tmp_path)


def test_training_pictures_of_fewer_traversals_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for entry in ("4-traversals", "1-traversals"):
        written(tmp_path, replace(JOB, entry=entry, seed=0))
    VERBS["show"](Arguments("show", tmp_path, group="ablation"), declared())
    text = capsys.readouterr().out
    assert "| 1-traversals | - | - | - | 30.00 | 20.00 |" in text
    assert "| 4-traversals | 30.00 | 0.800 | 0.100 | 30.00 |" in text
    assert "| 1-traversals | - | - | - | +0.000 |" in text


def test_what_is_published_is_shown_as_what_was_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    written(data)
    trial = Job("ours+rates1+sizes1", declared().tuning.scene, 0, declared().tuning.core_minutes, 240)
    written(data / "tuning", trial)
    written(data, replace(JOB, seed=2), declaration="another")
    assert VERBS["publish"](Arguments(data=data, out=out), declared()) == ExitCode.DONE
    assert sorted(path.name for path in out.rglob("*.json")) == sorted([f"{JOB.name}.json", f"{trial.name}.json"])
    assert "scores" not in json.loads((out / OUTCOMES / f"{JOB.name}.json").read_text())
    shown = []
    for folder in (data, out):
        capsys.readouterr()
        VERBS["show"](Arguments("show", folder), declared())
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert "| ours | 30.00 |" in shown[0] and "30.00 / 20.00" in shown[0]


def test_truth_is_told_of_models_that_are_gone_while_their_outcomes_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out, stale = tmp_path / "data", tmp_path / "out", replace(JOB, seed=2)
    ground = {"surface": "as drawn", "bias_m": -0.01, "median_m": 0.02, "p90_m": 0.03}
    costs = {"fps": 11.0, "wall_ms": 90.0, "core_ms": 10.0, "mb_per_100_m": 12.0, "threads": 1, "size_px": [480, 270]}
    for job, median_m, changes in ((JOB, 0.02, {}), (stale, 0.5, {"declaration": "another"})):
        written(data, job, **changes)
        nothing: dict[str, Any] = {"depth": [], "lighting": [], "seam": []}
        document = {"job": asdict(job), "ground": [{**ground, "median_m": median_m}], "costs": costs, **nothing}
        (data / TRUTH).mkdir(exist_ok=True)
        (data / TRUTH / f"{job.name}.json").write_text(json.dumps(document))
    row = {"group": "novel", "light": "own", "poses": "true", "pictures": 3, "psnr": 40.0, "psnr_cc": 41.0, "ssim": 0.9}
    exact = {"declaration": declared().hash, "scene": JOB.scene, "width_px": 240, "ceiling": [row]}
    for name, changes in ((f"{JOB.scene}.240px", {}), ("old.240px", {"declaration": "another"})):
        (data / TRUTH / f"ceiling.{name}.json").write_text(json.dumps({**exact, **changes}))
    VERBS["publish"](Arguments(data=data, out=out), declared())
    assert {path.name for path in (out / TRUTH).iterdir()} == {f"{JOB.name}.json", f"ceiling.{JOB.scene}.240px.json"}
    for folder in (data, out):
        capsys.readouterr()
        VERBS["truth"](Arguments("truth", folder), declared())
        text = capsys.readouterr().out
        assert "| ours | as drawn | -0.010 | 0.020 | 0.030 |" in text and "| ours | 11 |" in text
        assert f"| novel | own | true | {JOB.scene} | 40.00 | 41.00 | 0.900 | 3 |" in text and "| mean |" not in text
