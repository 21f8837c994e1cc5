"""The check itself: selection of rules, severities, exit codes, the verb, the page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import DatasetError, UsageError
from mirror.integrity import Cost, Severity, check
from mirror.integrity.finding import Finding
from mirror.integrity.registry import rules, select_rules
from mirror.integrity.rule import GROUPS, dataset_rule
from mirror.integrity.rules_page import rules_page
from tests.conftest import ROOT
from tests.integrity.clean import Broken
from tests.integrity.edit import A0


def test_the_page_is_current() -> None:
    page = (ROOT / "docs" / "rules.md").read_text()
    assert page == rules_page(), "run `python -m mirror.integrity.rules_page docs/rules.md`"


def test_every_rule_says_what_it_is() -> None:
    assert len(rules()) >= 40
    for rule in rules().values():
        assert rule.title.endswith("."), rule.rule_id
        assert rule.remedy, rule.rule_id
        assert (rule.of_dataset is None) != (rule.of_scene is None)
        assert rule.group in GROUPS


def test_remedies_name_the_command_that_mends() -> None:
    """A plain ingest writes lost and damaged tables again; what it takes for whole, only --replace writes again."""
    for name in ("DS004", "DS005", "DS006", "DS007", "FIL001", "FIL002", "FIL003", "TAB001", "TAB002"):
        assert "run the same `mirror ingest` again" in rules()[name].remedy
        assert "--replace" not in rules()[name].remedy
    for name in ("IMG001", "IMG002", "IMG004", "CAM002", "POS001"):
        assert "`mirror ingest RECORDING... --replace`" in rules()[name].remedy
    assert not [name for name, rule in rules().items() if "the drive again" in rule.remedy]


def test_an_id_is_given_once() -> None:
    with pytest.raises(ValueError, match="two rules have the id POS001"):

        @dataset_rule("POS001", Severity.ERROR, title="Again.", remedy="none")
        def again(view: object) -> list[Finding]:
            return []


def test_selection() -> None:
    assert {rule.rule_id for rule in select_rules(["POS003", "IMG"], ["IMG009"])} == {
        "POS003",
        *(name for name in rules() if name.startswith("IMG") and name != "IMG009"),
    }
    assert {rule.cost for rule in select_rules(cost=Cost.TABLES)} == {Cost.TABLES}
    assert {rule.cost for rule in select_rules()} == {Cost.TABLES, Cost.FILES}
    assert len(select_rules(cost=Cost.IMAGES)) == len(rules())
    assert [rule.rule_id for rule in select_rules(["img005"], cost=Cost.TABLES)] == ["IMG005"]
    with pytest.raises(UsageError, match="no rule 'POS099'"):
        select_rules(["POS099"])
    with pytest.raises(UsageError, match="no rule ''"):
        select_rules(skip=[""])


def test_severity_decides_the_exit_code(broken: Broken) -> None:
    broken.document("dataset.json", lambda raw: raw.update(licence=None))
    assert check(broken.root).exit_code(strict=True) == 0
    broken.set(
        A0, "ego_poses", range(1000), **{name: lambda row, name=name: -row[name] for name in ("qw", "qx", "qy", "qz")}
    )  # type: ignore[misc]
    broken.seal()
    report = check(broken.root)
    assert report.counts() == {"error": 0, "warning": 1, "info": 1}
    assert (report.exit_code(), report.exit_code(strict=True)) == (0, 1)
    assert [rule.rule_id for rule, _ in report.findings] == ["POS004", "DS013"]


def test_what_nobody_reports_is_unread(broken: Broken) -> None:
    broken.layout.split("s").unlink()
    broken.layout.split("s").write_text("{")
    report = check(broken.root, only=["SPL003"])
    assert report.findings == []
    assert len(report.unreadable) == 1
    assert report.exit_code() == 2
    assert check(broken.root, only=["SPL001", "SPL003"]).exit_code() == 1


@pytest.mark.parametrize("table", ["images", "ego_poses", "calibrations"])
def test_a_table_cut_short_is_found_and_the_rest_is_checked(table: str, broken: Broken) -> None:
    file = broken.layout.recorded(A0) / f"{table}.parquet"
    data = file.read_bytes()[:100]
    file.unlink()
    file.write_bytes(data)
    split = broken.layout.split("s").read_text().replace(A0, "gone")
    broken.layout.split("s").unlink()
    broken.layout.split("s").write_text(split)
    report = check(broken.root)
    found = {(rule.rule_id, finding.file) for rule, finding in report.findings}
    name = f"traversals/{A0}/recorded/{table}.parquet"
    assert {("FIL002", name), ("TAB001", name), ("SPL002", "splits/s.json")} <= found
    assert (report.exit_code(), report.unreadable) == (1, [])


def test_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not a dataset"):
        check(tmp_path)


def test_progress_counts_scenes(clean: Path) -> None:
    seen: list[int] = []
    check(clean, only=["POS"], start=seen.append, advance=seen.append)
    assert seen == [2, 1, 1]


def test_an_empty_dataset_is_whole(broken: Broken) -> None:
    import shutil

    for name in ("drives", "traversals", "splits", "rigs"):
        shutil.rmtree(broken.root / name)
    broken.root.joinpath("traversals").mkdir()
    broken.seal()
    assert check(broken.root, cost=Cost.IMAGES).findings == []


def test_the_verb(broken: Broken, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(broken.root), "--full"]) == 0
    assert "0 errors, 0 warnings, 0 infos" in capsys.readouterr().out
    broken.set(A0, "ego_poses", 50, qw=0.9)
    broken.seal()
    assert main(["check", str(broken.root), "--quick"]) == 1
    out = capsys.readouterr().out
    assert "POS003 error A pose's quaternion is not of unit length." in out
    assert f"traversals/{A0}/recorded/ego_poses.parquet: row 50" in out
    assert "remedy: normalise" in out
    assert main(["check", str(broken.root), "--json", "--rule", "POS003"]) == 1
    plain = json.loads(capsys.readouterr().out)
    assert plain["counts"] == {"error": 1, "warning": 0, "info": 0}
    assert plain["rules"] == ["POS003"]
    assert plain["findings"][0]["rule"] == "POS003"
    assert plain["exit_code"] == 1
    assert main(["check", str(broken.root), "--skip", "POS"]) == 0


@pytest.mark.parametrize("words", [["--rule", "NO1"], ["--quick", "--full"]])
def test_wrong_use_of_the_verb(clean: Path, words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(clean), *words]) == 2
    assert "mirror check" in capsys.readouterr().err


def test_the_verb_without_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path / "none")]) == 2
    assert "the folder does not exist" in capsys.readouterr().err


def test_a_heading_from_the_course_is_not_held_against_the_course(broken: Broken) -> None:
    turned = {"qw": 0.0, "qx": 0.0, "qy": 0.0, "qz": 1.0}
    broken.set(A0, "ego_poses", range(1000), **turned)
    broken.seal()
    assert [rule.rule_id for rule, _ in check(broken.root, only=["GEO003"]).findings] == ["GEO003"]
    broken.set(A0, "ego_poses", range(1000), orientation="course")
    broken.seal()
    assert check(broken.root, only=["GEO003"]).findings == []


def test_one_rule_is_one_rule(clean: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(clean), "--rule", "GEO003"]) == 0
    assert f"1 of {len(rules())} rules: 0 errors" in capsys.readouterr().out
