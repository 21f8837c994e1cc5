"""Rows of suites: states verified, policies that the organiser ran, and the test split of a secret."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.evaluation.rollouts import evaluate_rollouts
from mirror.protocols import document
from mirror.protocols.document import Protocol, commit_to_secret, load_protocol, parse_protocol, read_definition
from mirror.protocols.suite import list_drives
from mirror.schema.files import write_json
from mirror.schema.rollout import STATES_FILE
from mirror.schema.suite_run import SUITE_FILE, SuiteRun
from mirror_leaderboard import add, boards
from mirror_leaderboard.add import add_result
from mirror_leaderboard.boards import make_boards
from mirror_leaderboard.entry import Measured, load_entries
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import Sources, SuitePlan
from mirror_leaderboard.site.tables import list_variant

needs_bubblewrap = pytest.mark.skipif(shutil.which("bwrap") is None, reason="bubblewrap is not installed")
SECRET = b"7d" * 32
POLICY = """
from hybridworldsim.simulator.ego.vehicle import Controls

class Straight:
    cameras, privileged, steps = (), False, 0

    def reset(self, spec):
        self.seed = spec.seed

    def act(self, observation):
        self.steps += 1
        if self.seed == 1 and self.steps > 7:
            raise ValueError("lost")
        x, y = observation.route[2]
        return Controls(0.0, 2.0 * y / max(x * x + y * y, 1.0))

    def close(self):
        pass
"""


def short_suite() -> bytes:
    """The suite with one scenario from two starts of two seconds on a small street."""
    text = read_definition("closed-loop").decode()
    head, *streets = text.split("[[suite.streets]]")
    starts = "".join(streets).split("[[suite.starts]]")
    metrics = text[text.index("[[metrics]]") :]
    head = head.replace("duration_s = 12.0", "duration_s = 2.0")
    names = head[head.index("scenarios = [") : head.index("]\n", head.index("scenarios = [")) + 2]
    head = head.replace(names, 'scenarios = ["hard-brake"]\n')
    street = '[[suite.streets]]\nsource = "synth:tiny:1:guangzhou-urban-01"\nscene = "guangzhou-urban-1"\n\n'
    return (head + street + "".join(f"[[suite.starts]]{one}" for one in starts[1:3]) + metrics).encode()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the suite, and the drives of a policy that fails in one of them."""
    out = tmp_path_factory.mktemp("rows")
    (out / "short.toml").write_bytes(short_suite())
    (out / "policy.py").write_text(POLICY)
    words = ["simulate", "--suite", str(out / "short.toml"), "--policy", f"{out / 'policy.py'}:Straight"]
    assert main([*words, "--out", str(out / "runs"), "--workers", "1"]) == ExitCode.FINDINGS
    return out


@pytest.fixture(autouse=True)
def _shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board takes the protocols that ship: here the short suite ships in place of the whole one."""
    whole = document.load_protocol

    def load(name: str, *, masked: bool = True) -> Protocol:
        return parse_protocol(short_suite(), "short.toml") if name == "closed-loop" else whole(name, masked=masked)

    monkeypatch.setattr(add, "load_protocol", load)
    monkeypatch.setattr(boards, "load_protocol", load)


def result_of(runs: Path, protocol: Protocol, out: Path, secret: bytes | None = None) -> Path:
    evaluate_rollouts(runs, protocol, out, secret=secret)
    plain = json.loads((out / "result.json").read_text())
    plain["submission"]["method"]["name"] = "straight"
    return out / "result.json"


def submit(result: Path, runs: Path, board: Path, **options: object) -> Measured:
    add_result(result, board, "closed loop", sources=replace(Sources(str(runs)), **options))  # type: ignore[arg-type]
    (entry,) = load_entries(board / "entries")
    assert isinstance(entry, Measured)
    return entry


def test_all_drives_are_driven_again_with_the_ones_that_the_policy_ended(folder: Path, tmp_path: Path) -> None:
    protocol = parse_protocol(short_suite(), "short.toml")
    result = result_of(folder / "runs", protocol, tmp_path / "results")
    entry = submit(result, folder / "runs", tmp_path / "board", plan=SuitePlan())
    assert entry.verified and entry.policy_run is None
    (board,) = make_boards([entry])
    assert list(list_variant(entry, board)) == ["states verified"]
    # One metre more at one instant of one drive.
    runs = tmp_path / "forged"
    shutil.copytree(folder / "runs", runs)
    forge(runs / "guangzhou-urban-1" / "hard-brake-0")
    result = result_of(runs, protocol, tmp_path / "forged-results")
    with pytest.raises(RefusedError, match="not the states"):
        submit(result, runs, tmp_path / "other", plan=SuitePlan())


def forge(run: Path) -> None:
    from mirror.metrics.safety import read_state_log, write_state_log
    from mirror.schema.rollout import list_files, read_rollout

    rollout, log = read_rollout(run), read_state_log(run / STATES_FILE)
    x = log.x_m.copy()
    x[5:, 0] += 0.01
    write_state_log(run / STATES_FILE, replace(log, x_m=x))
    write_json(run / "run.json", rollout.model_copy(update={"files": list_files(run)}))


def test_the_organisers_badge_takes_a_policy_that_ran_apart(folder: Path, tmp_path: Path) -> None:
    protocol = parse_protocol(short_suite(), "short.toml")
    runs = tmp_path / "runs"
    shutil.copytree(folder / "runs", runs)
    result = result_of(runs, protocol, tmp_path / "results")
    with pytest.raises(RefusedError, match="policy that ran apart"):
        submit(result, runs, tmp_path / "board", plan=SuitePlan(), ran_here=True)
    run = SuiteRun(protocol=protocol.name, protocol_hash=protocol.hash, policy="sandbox:x", isolation="sandbox")
    write_json(runs / SUITE_FILE, run)
    entry = submit(result, runs, tmp_path / "board", plan=SuitePlan(), ran_here=True)
    assert entry.verified and entry.policy_run == "sandbox"
    (board,) = make_boards([entry])
    assert list(list_variant(entry, board)) == ["states verified", "policy run by the organiser (sandbox)"]


def test_a_test_split_takes_no_policy_in_the_simulators_process(folder: Path, tmp_path: Path) -> None:
    plain = parse_protocol(short_suite(), "short.toml")
    protocol = commit_to_secret(plain, hashlib.sha256(SECRET).hexdigest())
    assert protocol.hash != plain.hash
    (tmp_path / "test.toml").write_text(
        short_suite().decode().replace("seed = 5200", f'commitment = "{hashlib.sha256(SECRET).hexdigest()}"')
    )
    assert load_protocol(str(tmp_path / "test.toml")).hash == protocol.hash
    (tmp_path / "secret").write_bytes(SECRET)
    words = ["simulate", "--suite", str(tmp_path / "test.toml"), "--out", str(tmp_path / "runs"), "--policy", "idm"]
    assert main(words) == ExitCode.COULD_NOT_RUN
    assert main([*words, "--secret", str(tmp_path / "secret")]) == ExitCode.COULD_NOT_RUN
    assert not (tmp_path / "runs").exists()


def list_draws(protocol: Protocol) -> set[str]:
    """List the numbers that the secret drew, as text: starts and parameters of the agents."""
    plain = parse_protocol(short_suite(), "short.toml").suite
    assert plain is not None and protocol.suite is not None and plain.draw is not None
    undrawn = plain.model_copy(update={"draw": None})
    drives = zip(list_drives(protocol.suite, SECRET), list_drives(undrawn), strict=True)
    found = set()
    for drawn, base in drives:
        numbers = [set(re.findall(r"\d+\.\d{2,}", one.scenario.model_dump_json())) for one in (drawn, base)]
        found |= numbers[0] - numbers[1]
    return found


@needs_bubblewrap
def test_a_test_split_is_driven_scored_and_published_without_its_secret(tmp_path: Path) -> None:
    commitment = hashlib.sha256(SECRET).hexdigest()
    suite, secret = tmp_path / "test.toml", tmp_path / "secret"
    suite.write_text(short_suite().decode().replace("seed = 5200", f'commitment = "{commitment}"'))
    secret.write_bytes(SECRET)
    (tmp_path / "policy").mkdir()
    (tmp_path / "policy" / "policy.py").write_text(POLICY)
    runs, scores, board, site = (tmp_path / name for name in ("runs", "scores", "board", "site"))
    policy = f"sandbox:{tmp_path / 'policy' / 'policy.py'}:Straight"
    words = ["--secret", str(secret)]
    simulate = ["simulate", "--suite", str(suite), "--policy", policy, "--out", str(runs), "--workers", "1"]
    assert main([*simulate, *words]) == ExitCode.FINDINGS  # one drive ends by the policy
    evaluate = ["evaluate", str(runs), "--protocol", str(suite), "--out", str(scores), "--report"]
    assert main([*evaluate, *words]) == ExitCode.DONE
    add_words = ["leaderboard", "add", str(scores / "result.json"), str(runs), "--again", "--ran-here"]
    assert main([*add_words, *words, "--dataset-name", "test split", "--board", str(board)]) == ExitCode.DONE
    assert main(["leaderboard", "build", "--board", str(board), "--out", str(site), "--unsigned"]) == ExitCode.DONE
    (entry,) = load_entries(board / "entries")
    assert isinstance(entry, Measured) and entry.verified and entry.policy_run == "sandbox"
    drawn = list_draws(load_protocol(str(suite)))
    assert len(drawn) >= 4
    published = [path for folder in (scores, board, site) for path in folder.rglob("*") if path.is_file()]
    text = b"\n".join(path.read_bytes() for path in published).decode("utf-8", "replace")
    assert commitment in text and "policy run by the organiser" in text
    assert SECRET.decode() not in text and SECRET.hex() not in text
    # The rollouts, which stay with the organiser, have the drawn scenarios.
    kept = "".join(path.read_text() for path in runs.rglob("scenario.toml"))
    assert all(number in kept for number in drawn)
    assert [number for number in drawn if number in text] == []
