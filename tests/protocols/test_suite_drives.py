"""Drives of suites: clusters, draws from public seeds and secrets, and what a suite refuses."""

from __future__ import annotations

import hashlib
import hmac
from pathlib import Path
from typing import Any

import pytest

from mirror.errors import SchemaError, UsageError
from mirror.protocols.document import Protocol, load_protocol, parse_protocol, read_definition
from mirror.protocols.suite import Suite, list_drives, read_secret
from mirror.schema.scenario import LaneStart, encode_scenario, read_scenario

SECRET = b"4f" * 32
COMMITMENT = hashlib.sha256(SECRET).hexdigest()


def suite_of(protocol: Protocol) -> Suite:
    assert protocol.suite is not None
    return protocol.suite


def committed(commitment: str = COMMITMENT) -> Protocol:
    text = read_definition("closed-loop").decode().replace("seed = 5200", f'commitment = "{commitment}"')
    return parse_protocol(text.replace('name = "closed-loop"', 'name = "closed-loop-test"').encode(), "test.toml")


@pytest.mark.parametrize("name", ["closed-loop", "closed-loop-robust"])
def test_the_suites_have_300_drives_in_30_clusters(name: str) -> None:
    suite = suite_of(load_protocol(name))
    drives = list_drives(suite)
    assert len(drives) == len({drive.key for drive in drives}) == len({drive.folder for drive in drives}) == 300
    assert len({drive.key[:2] for drive in drives}) == 30
    assert all(drive.scenario.duration_s == 12.0 and drive.scenario.rate_hz == 5.0 for drive in drives)
    faults = {drive.sensors.name for drive in drives if drive.sensors is not None}
    assert len(faults) == (10 if name.endswith("robust") else 0)


def test_draws_are_hmacs_of_the_names_and_lie_in_their_ranges() -> None:
    suite = suite_of(load_protocol("closed-loop"))
    assert suite.draw is not None
    starts = {start.seed: start for start in suite.starts}
    seen = set()
    for drive in list_drives(suite):
        start, shipped = starts[drive.scenario.seed], read_scenario(drive.scenario.name)
        assert isinstance(drive.scenario.ego.start, LaneStart)
        digest = hmac.new(
            b"mirror-suite-5200",
            f"{drive.street.scene}/{drive.scenario.name}/{start.seed}/speed_mps".encode(),
            hashlib.sha256,
        ).digest()
        u = int.from_bytes(digest[:6], "big") / 2.0**47 - 1.0
        assert drive.scenario.ego.speed_mps == round(start.speed_mps * (1.0 + 0.1 * u), 3)
        assert start.along_m <= drive.scenario.ego.start.along_m <= start.along_m + 4.0
        seen.add(drive.scenario.ego.speed_mps)
        for agent, plain in zip(drive.scenario.agents, shipped.agents, strict=True):
            drawn: dict[str, Any] = agent.behaviour.model_dump()
            for key, value in plain.behaviour.model_dump().items():
                if key in ("ahead_m", "speed_mps") and value is not None:
                    assert abs(drawn[key] / value - 1.0) <= 0.2 + 1e-3
                elif key != "trigger":
                    assert drawn[key] == value or key == "ttc_s"
    assert len(seen) > 250


def test_drives_without_draws_are_the_scenarios_with_their_starts() -> None:
    suite = suite_of(load_protocol("closed-loop-mini"))
    drive = list_drives(suite)[1]
    shipped = read_scenario("cut-in")
    ego = shipped.ego.model_copy(update={"start": LaneStart(kind="lane", along_m=15.0), "speed_mps": 11.0})
    expected = shipped.model_copy(update={"seed": 1, "duration_s": 8.0, "rate_hz": 5.0, "ego": ego})
    assert encode_scenario(drive.scenario) == encode_scenario(expected)


def test_a_secret_draws_other_scenarios_and_stands_in_no_document(tmp_path: Path) -> None:
    protocol = committed()
    suite, file = suite_of(protocol), tmp_path / "secret.txt"
    file.write_bytes(SECRET + b"\n")
    assert read_secret(file, suite, "test") == SECRET
    public, secret = list_drives(suite_of(load_protocol("closed-loop"))), list_drives(suite, SECRET)
    assert [drive.key for drive in public] == [drive.key for drive in secret]
    assert not any(one.scenario == two.scenario for one, two in zip(public, secret))
    other = list_drives(suite, b"50" * 32)
    assert not any(one.scenario == two.scenario for one, two in zip(other, secret))
    assert protocol.hash != load_protocol("closed-loop").hash
    assert SECRET.decode() not in protocol.model_dump_json()


def test_another_secret_none_and_a_needless_one_are_refused(tmp_path: Path) -> None:
    suite, file = suite_of(committed()), tmp_path / "secret.txt"
    file.write_bytes(b"50" * 32)
    with pytest.raises(UsageError, match="not the secret") as error:
        read_secret(file, suite, "test")
    assert "5050" not in str(error.value)
    with pytest.raises(UsageError, match="organiser's secret"):
        read_secret(None, suite, "test")
    with pytest.raises(UsageError, match="organiser's secret"):
        list_drives(suite)
    with pytest.raises(UsageError, match="has no secret"):
        read_secret(file, suite_of(load_protocol("closed-loop")), "closed-loop")
    with pytest.raises(UsageError, match="cannot be read"):
        read_secret(tmp_path / "missing", suite, "test")
    short = b"secret"
    file.write_bytes(short)
    with pytest.raises(UsageError, match="32 or more bytes"):
        read_secret(file, suite_of(committed(hashlib.sha256(short).hexdigest())), "test")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 5200, ", "", "either a public seed or the commitment"),
        ("seed = 5200", f'seed = 5200, commitment = "{COMMITMENT}"', "either a public seed or the commitment"),
        ('sensors = "bright"', 'sensors = "brilliant"', "brilliant"),
        ('dropped = ["front_wide"]\nafter_s', 'dropped = ["rear"]\nafter_s', "drops the camera 'rear'"),
    ],
)
def test_a_suite_with_a_wrong_draw_or_fault_is_refused(old: str, new: str, message: str) -> None:
    text = read_definition("closed-loop-robust").decode()
    assert old in text
    with pytest.raises(SchemaError, match=message):
        parse_protocol(text.replace(old, new).encode(), "suite.toml")
