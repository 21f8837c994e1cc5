"""Suites of drives: the same bytes for any number of workers, resumed, and failures of policies and of machines."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmarks.suite_kills import drive_with_kills, read_files, spread_points
from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.protocols.document import load_protocol, read_definition
from mirror.protocols.suite import list_drives

POLICY = """
import os
from pathlib import Path
from hybridworldsim.simulator.ego.vehicle import Controls

HERE = Path(__file__).parent

class Straight:
    cameras, privileged = (), False

    def reset(self, spec):
        pass

    def act(self, observation):
        return Controls(0.0, 0.0)

    def close(self):
        pass

class Faster(Straight):
    def act(self, observation):
        return Controls(1.0, 0.0)

class FailsLate(Straight):
    steps = 0

    def act(self, observation):
        self.steps += 1
        if self.steps > 7:
            raise ValueError("lost")
        return super().act(observation)

class Fails(Straight):
    def act(self, observation):
        raise ValueError("lost at once")

class Dies(Straight):
    # The process ends in the first drive that comes to its seventh step; if the file `always` exists, in each.
    steps = 0

    def act(self, observation):
        self.steps += 1
        if self.steps == 7 and ((HERE / "always").exists() or not (HERE / "died").exists()):
            (HERE / "died").touch()
            os._exit(9)
        return super().act(observation)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a suite of two drives of two seconds, and policies."""
    out = tmp_path_factory.mktemp("suite")
    text = read_definition("closed-loop-mini").decode()
    text = text.replace("duration_s = 8.0", "duration_s = 2.0").replace('name = "closed-loop-mini"', 'name = "short"')
    text = text.replace('"crossing-pedestrian", "stopped-queue", "free-traffic"', "").replace('"hard-brake", ', "")
    text = text.replace("synth:reconstruction:1:", "synth:tiny:1:")
    for table in ("streets", "starts"):
        first, second, *rest = text.split(f"[[suite.{table}]]")
        text = f"{first}[[suite.{table}]]{second}" + (rest[0][rest[0].index("[[") :] if table == "streets" else "")
        if table == "starts":
            text += "\n[[suite.starts]]\nseed = 1\nalong_m = 15.0\nspeed_mps = 11.0\n"
            text += "".join(f'\n[[metrics]]\nmetric = "{name}"\n' for name in ("epdms", "progress_share"))
    (out / "short.toml").write_text(text)
    (out / "policies.py").write_text(POLICY)
    return out


@pytest.fixture(scope="module")
def driven(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drives of one worker; tests do not change them."""
    out = tmp_path_factory.mktemp("driven") / "runs"
    assert simulate(folder, "Straight", out, "--workers", "1") == ExitCode.DONE
    return out


def simulate(folder: Path, policy: str, out: Path, *options: str) -> int:
    suite = str(folder / "short.toml")
    name = f"{folder / 'policies.py'}:{policy}"
    return main(["simulate", "--suite", suite, "--policy", name, "--out", str(out), *options])


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def evaluate(folder: Path, runs: Path, out: Path) -> dict[str, Any]:
    suite = str(folder / "short.toml")
    assert main(["evaluate", str(runs), "--protocol", suite, "--out", str(out)]) == ExitCode.DONE
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    return result


def test_the_mini_suite_has_twenty_drives_in_ten_clusters() -> None:
    suite = load_protocol("closed-loop-mini").suite
    assert suite is not None
    drives = list_drives(suite)
    assert len({drive.key for drive in drives}) == len({drive.folder for drive in drives}) == 20
    assert len({drive.key[:2] for drive in drives}) == 10


def test_other_workers_and_an_interruption_give_the_same_bytes(
    folder: Path, driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    expected = files(driven)
    assert sum(name.endswith("run.json") for name in expected) == 2
    # As if killed: one drive had not ended, and what it had written is torn.
    shutil.copytree(driven, tmp_path / "two")
    torn = tmp_path / "two" / "guangzhou-urban" / "cut-in-1"
    (torn / "run.json").unlink()
    (torn / ".driving").touch()
    (torn / "states.parquet").write_bytes(b"torn")
    # The other one had ended, but its mark was still there; a document was not yet renamed.
    (torn.with_name("cut-in-0") / ".driving").touch()
    (tmp_path / "two" / ".suite.json.0a1b2c3d-77-0.tmp").touch()
    capsys.readouterr()
    assert simulate(folder, "Straight", tmp_path / "two", "--workers", "2", "--json") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["reused"] == 1
    assert files(tmp_path / "two") == expected
    assert simulate(folder, "Straight", tmp_path / "two") == ExitCode.DONE
    assert simulate(folder, "Faster", tmp_path / "two") == ExitCode.COULD_NOT_RUN
    assert "another suite or policy" in capsys.readouterr().err
    result = evaluate(folder, tmp_path / "two", tmp_path / "results")
    assert [one["key"] for one in result["clusters"]] == ["guangzhou-urban, cut-in"]
    shutil.rmtree(torn)
    suite = str(folder / "short.toml")
    assert main(["evaluate", str(tmp_path / "two"), "--protocol", suite, "--out", str(tmp_path / "results")]) == 2
    assert "1 drive of 2 are missing, the first: guangzhou-urban/cut-in-1" in capsys.readouterr().err


def test_a_drive_that_the_policy_ends_has_the_score_0(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert simulate(folder, "FailsLate", tmp_path / "runs", "--workers", "1") == ExitCode.FINDINGS
    assert "the policy failed in guangzhou-urban/cut-in-0" in capsys.readouterr().out
    result = evaluate(folder, tmp_path / "runs", tmp_path / "results")
    scores = {one["metric"]: one["value"] for one in result["figures"] if one["level"] == "group"}
    assert scores["epdms"] == 0.0
    assert "whose PDMS and EPDMS are 0" in result["warnings"][-1]


def test_a_policy_that_fails_at_once_begins_no_drive(
    folder: Path, driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert simulate(folder, "Fails", tmp_path / "runs") == ExitCode.COULD_NOT_RUN
    assert "lost at once" in capsys.readouterr().err
    assert list(files(tmp_path / "runs")) == ["suite.json"]
    # The mended command may name the same folder.
    assert simulate(folder, "Straight", tmp_path / "runs") == ExitCode.DONE
    assert files(tmp_path / "runs") == files(driven)


def test_a_drive_whose_process_ends_is_driven_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # One drive, since each new process takes a second or two.
    text = (folder / "short.toml").read_text()
    shutil.copy(folder / "policies.py", tmp_path)
    (tmp_path / "short.toml").write_text(
        text.replace("[[suite.starts]]\nseed = 1\nalong_m = 15.0\nspeed_mps = 11.0\n", "")
    )
    assert simulate(tmp_path, "Dies", tmp_path / "runs") == ExitCode.DONE
    assert (tmp_path / "died").exists()
    (tmp_path / "always").touch()
    capsys.readouterr()
    assert simulate(tmp_path, "Dies", tmp_path / "again") == ExitCode.PARTLY_DONE
    assert "the machine failed in guangzhou-urban/cut-in-0: its process ended" in capsys.readouterr().out
    assert not list((tmp_path / "again").rglob("run.json"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "3"], "the suite states it"),
        (["--policy", "grpc://localhost:1"], "an installed policy"),
        (["--workers", "0"], "at least 1"),
    ],
)
def test_options_that_a_suite_states_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    words = ["simulate", "--suite", str(folder / "short.toml"), "--out", str(tmp_path / "runs")]
    policy = [] if "--policy" in options else ["--policy", "idm"]
    assert main([*words, *policy, *options]) == ExitCode.COULD_NOT_RUN
    assert message in capsys.readouterr().err


def test_a_command_that_is_killed_and_repeated_has_the_bytes_of_an_uninterrupted_one(
    folder: Path, driven: Path, tmp_path: Path
) -> None:
    """One point of a suite; `python -m benchmarks suite_kills` has forty."""
    policy = f"{folder / 'policies.py'}:Straight"
    words = ["--suite", str(folder / "short.toml"), "--policy", policy, "--workers", "1"]
    expected = read_files(driven)
    assert drive_with_kills(words, tmp_path / "killed", spread_points(len(expected), 1)) == 1
    assert read_files(tmp_path / "killed") == expected
