"""The tutorial of policies apart, with a short suite; each part is skipped where its program is missing."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from hybridworldsim.simulator.isolation import container
from mirror.cli.main import main
from tests.conftest import ROOT
from tests.tutorial_pages import follow, read_blocks
from tests.tutorials.small_suite import write_small_suite

PAGE = "tutorials/container.md"
BASE = "python:3.11-slim"


def read_endings(scores: Path) -> dict[str, float]:
    figures = json.loads((scores / "result.json").read_text())["figures"]
    return {one["metric"]: one["value"] for one in figures if one["level"] == "group"}


@pytest.mark.skipif(shutil.which("bwrap") is None, reason="bubblewrap is not installed: apt-get install bubblewrap")
def test_a_policy_drives_in_a_sandbox(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    suite = write_small_suite(capsys)
    follow(
        PAGE,
        parts=("Write it", "In a sandbox"),
        shorter={"simulate --suite": suite, "evaluate apart": suite},
        stand_ins={},
        capsys=capsys,
    )
    assert (tmp_path / "apart-scores" / "report.html").is_file()
    # In this process the same policy drives to the same figures.
    small = ["--suite", "small.toml", "--policy", "my_policy.py:Follow", "--out", "here"]
    assert main(["simulate", *small]) == 0
    assert main(["evaluate", "here", "--protocol", "small.toml", "--out", "here-scores"]) == 0
    here, apart = (read_endings(tmp_path / name) for name in ("here-scores", "apart-scores"))
    assert here.keys() == apart.keys() and apart["epdms"] == pytest.approx(here["epdms"], abs=0.05)


def test_a_policy_drives_in_a_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    engine = container.find_engine()
    if engine is None:
        pytest.skip("neither podman nor docker answers: apt-get install podman")
    if subprocess.run([engine, "image", "inspect", BASE], capture_output=True, check=False).returncode:
        pytest.skip(f"no image {BASE} here: `{Path(engine).name} pull {BASE}` fetches it")
    monkeypatch.chdir(tmp_path)
    suite = write_small_suite(capsys)
    (policy,) = [text for language, text in read_blocks(PAGE, ["Write it"]) if language == "python"]
    page = (ROOT / "docs" / PAGE).read_text()
    context = tmp_path / "context"
    ignored = shutil.ignore_patterns(".*", "build", "tests", "docs", "benchmarks")
    shutil.copytree(ROOT, context, ignore=ignored)
    (context / "Dockerfile").write_text(page.split("```dockerfile\n")[1].split("```")[0])
    (context / "my_policy.py").write_text(policy)
    built = subprocess.run(
        [engine, "build", "--tag", "my-policy:1", str(context)], capture_output=True, text=True, check=False
    )
    if built.returncode and "pip" in built.stderr:
        pytest.skip("the image's packages cannot be fetched here")
    assert built.returncode == 0, built.stderr
    words = ["--suite", "small.toml", "--policy", "my_policy.py:Follow", "--out", "apart"]
    (tmp_path / "my_policy.py").write_text(policy)
    assert main(["simulate", *words]) == 0
    assert main(["evaluate", "apart", "--protocol", "small.toml", "--out", "apart-scores"]) == 0
    follow(
        PAGE,
        parts=("In a container",),
        shorter={"simulate --suite": suite, "evaluate contained": suite},
        stand_ins={},
        capsys=capsys,
    )
    assert read_endings(tmp_path / "contained-scores")["epdms"] == pytest.approx(
        read_endings(tmp_path / "apart-scores")["epdms"], abs=0.05
    )
