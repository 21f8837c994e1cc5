"""SQL over a dataset: the answers of its tables, and no way out of them; the index without MIRROR."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.query.catalog import TABLES
from mirror.dataset.sql import has_spatial_functions
from mirror.errors import UsageError
from tests.builders.street import make_street
from tests.interruption import interrupt

pytest.importorskip("duckdb", reason="the extra sql is not installed")


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_street(tmp_path_factory.mktemp("street") / "it's a dataset", ("front_wide", "front_narrow"))


@pytest.mark.parametrize("name", TABLES)
def test_every_table_has_its_rows_from_files_and_from_memory(street: Dataset, name: str) -> None:
    expected = street.table(name)
    plain = pa.schema(
        [item.with_type(pa.string()) if pa.types.is_dictionary(item.type) else item for item in expected.schema]
    )
    rows = expected.cast(plain).to_pylist()
    assert street.sql(f"SELECT * FROM {name}").to_pylist() == rows
    assert street.where(scene="a").sql(f"select * from {name.upper()}").to_pylist() == rows


def test_a_view_with_filters_has_its_rows_only(street: Dataset) -> None:
    night = street.where(light="night", camera="front_narrow")
    query = "SELECT count(*) AS n, min(camera) AS camera FROM images"
    assert night.sql(query).to_pylist() == [{"n": 5, "camera": "front_narrow"}]
    assert street.sql(query).to_pylist() == [{"n": 20, "camera": "front_narrow"}]
    joined = (
        "WITH t AS (SELECT traversal_id, light FROM traversals) SELECT light, count(*) AS n FROM boxes JOIN t"
        " USING (traversal_id) GROUP BY light ORDER BY light"
    )
    assert street.sql(joined).to_pylist() == [{"light": "day", "n": 10}, {"light": "night", "n": 10}]
    assert night.sql(joined).to_pylist() == [{"light": "night", "n": 10}]


ESCAPES = {
    "read a file": "SELECT * FROM read_csv('/etc/passwd')",
    "read another file of the dataset": "SELECT * FROM read_text('{root}/dataset.json')",
    "list files": "SELECT * FROM glob('/etc/*')",
    "read a file by its name": "SELECT * FROM '/etc/passwd'",
    "read a URL": "SELECT * FROM read_parquet('https://example.org/x.parquet')",
    "copy": "COPY (SELECT 1) TO '{out}/x.csv'",
    "copy over the index": "COPY (SELECT 1) TO '{root}/index/scenes.parquet'",
    "copy in a subquery": "SELECT * FROM query('COPY (SELECT 1) TO ''{out}/x.csv''')",
    "attach": "ATTACH '{out}/x.db'",
    "install": "INSTALL spatial",
    "load": "LOAD httpfs",
    "unlock": "SET enable_external_access = true",
    "unlock after a query": "SELECT 1; SET enable_external_access = true; SELECT * FROM read_csv('/etc/passwd')",
    "export": "EXPORT DATABASE '{out}/x'",
    "explain analyze": "EXPLAIN ANALYZE COPY (SELECT 1) TO '{out}/x.csv'",
    "a variable of the program": "SELECT * FROM dataset",
    "settings": "PRAGMA database_list",
    "create": "CREATE TABLE x AS SELECT 1",
}


@pytest.mark.parametrize("query", ESCAPES.values(), ids=ESCAPES)
def test_no_query_leaves_the_tables(street: Dataset, query: str, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in Path(street.root).rglob("*") if path.is_file()}
    root = street.root.replace("'", "''")
    with pytest.raises(UsageError):
        street.sql(query.format(root=root, out=tmp_path))
    assert list(tmp_path.iterdir()) == []
    assert {path: path.read_bytes() for path in Path(street.root).rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("query", ["INSTALL httpfs", "load httpfs"])
def test_extensions_are_refused_by_the_word_that_was_written(street: Dataset, query: str) -> None:
    with pytest.raises(UsageError, match="has INSTALL or LOAD"):
        street.sql(query)


def test_the_configuration_is_locked(street: Dataset) -> None:
    settings = street.sql(
        "SELECT name, value FROM duckdb_settings() WHERE name IN ('enable_external_access', 'lock_configuration',"
        " 'autoload_known_extensions', 'autoinstall_known_extensions', 'python_enable_replacements', 'temp_directory')"
    ).to_pylist()
    assert {row["name"]: row["value"] for row in settings} == {
        "enable_external_access": "false",
        "lock_configuration": "true",
        "autoload_known_extensions": "false",
        "autoinstall_known_extensions": "false",
        "python_enable_replacements": "false",
        "temp_directory": "",
    }


def test_spatial_functions_only_where_the_extension_is(street: Dataset) -> None:
    query = "SELECT ST_X(ST_Point(1.0, 2.0)) AS x"
    if has_spatial_functions():
        assert street.sql(query).to_pylist() == [{"x": 1.0}]
    else:
        with pytest.raises(UsageError, match="spatial"):
            street.sql(query)
    assert street.sql("SELECT typeof(bbox.xmin) AS kind FROM scenes").to_pylist() == [{"kind": "DOUBLE"}]


def test_errors_name_what_is_wrong(street: Dataset) -> None:
    with pytest.raises(UsageError, match="Table with name imagess does not exist") as raised:
        street.sql("SELECT * FROM imagess")
    assert "docs/schema.md" in str(raised.value)
    with pytest.raises(UsageError, match="syntax error"):
        street.sql("SELEC 1")
    with pytest.raises(UsageError, match="the query has no statement"):
        street.sql("  ")


def test_the_verb_prints_and_writes(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = (
        "SELECT camera, count(*) AS n, list(DISTINCT privacy) AS p, min(sha256) AS h FROM images GROUP BY 1 ORDER BY 1"
    )
    assert main(["sql", street.root, query]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:2] == ["front_narrow", "10"]
    assert main(["sql", street.root, query, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["camera"], row["n"], row["p"]) for row in rows] == [
        ("front_narrow", 10, ["raw"]),
        ("front_wide", 10, ["raw"]),
    ]
    expected = street.sql(query)
    for suffix in (".csv", ".parquet", ".arrow"):
        out = tmp_path / f"result{suffix}"
        assert main(["sql", street.root, query, "--out", str(out)]) == 0
        if suffix == ".parquet":
            assert pq.read_table(out).to_pylist() == expected.to_pylist()
        elif suffix == ".arrow":
            assert pa.ipc.open_file(out).read_all().to_pylist() == expected.to_pylist()
        else:
            found = list(csv.DictReader(out.open()))
            assert [(row["camera"], int(row["n"]), json.loads(row["p"]), row["h"]) for row in found] == [
                (row["camera"], row["n"], row["p"], row["h"]) for row in rows
            ]
    capsys.readouterr()
    assert main(["sql", street.root, "SELECT * FROM images", "--rows", "3"]) == 0
    assert "... 17 more rows" in capsys.readouterr().out
    assert main(["sql", street.root, "SELECT 1", "--out", str(tmp_path / "x.txt")]) == 2
    assert main(["sql", street.root, "SELECT 1", "--out", f"{street.root}/x.csv"]) == 2


def test_a_long_query_can_be_interrupted(street: Dataset) -> None:
    query = "SELECT sum(a.range * b.range) FROM range(10000000) a, range(10000000) b"
    ended = interrupt(["sql", street.root, query], 0.5)
    assert ended.hit
    ended.require_stopped()


OTHERS = """
import json, sys
from pathlib import Path
import {module}
index = Path(sys.argv[1]) / "index"
snapshot = json.loads(max(index.glob("snapshots/*.json")).read_text())
segments = [index / one["name"] for one in snapshot["segments"]]
{read}
assert not [name for name in sys.modules if name.split(".")[0] == "mirror"]
print(len(traversals), len(images), images["byte_length"].sum(), sorted(set(images["camera"])))
"""
READERS = {
    "pandas": "traversals = pandas.concat(pandas.read_parquet(one / 'traversals.parquet') for one in segments)\n"
    "paths = [path for one in segments for path in sorted(one.glob('images/*.parquet'))]\n"
    "images = pandas.concat(map(pandas.read_parquet, paths))",
    "polars": "traversals = polars.concat(polars.read_parquet(one / 'traversals.parquet') for one in segments)\n"
    "images = polars.concat(polars.read_parquet(one / 'images' / '*.parquet') for one in segments)",
}


@pytest.mark.parametrize("module", READERS)
def test_other_libraries_open_the_index_by_its_documented_paths(street: Dataset, module: str) -> None:
    pytest.importorskip(module, reason=f"{module} is not installed")
    code = OTHERS.format(module=module, read=READERS[module])
    done = subprocess.run([sys.executable, "-c", code, street.root], capture_output=True, text=True, check=True)
    total = sum(street.table("images", ["byte_length"]).column(0).to_pylist())
    assert done.stdout.strip() == f"2 20 {total} ['front_narrow', 'front_wide']"


def test_csv_quotes_what_a_spreadsheet_would_run(street: Dataset, tmp_path: Path) -> None:
    """Before: only the board's downloads did. A dataset has texts of strangers: categories, names of cameras, notes."""
    query = """SELECT '=HYPERLINK("x")' AS "=head", '@x' AS a, -1.5 AS n, '\t=1' AS t, '＝1' AS w, 'plain' AS p"""
    assert main(["sql", street.root, query, "--out", str(tmp_path / "out.csv")]) == 0
    with (tmp_path / "out.csv").open(newline="") as file:
        head, row = csv.reader(file)
    assert head == ["'=head", "a", "n", "t", "w", "p"]
    assert row == ["""'=HYPERLINK("x")""", "'@x", "-1.5", "'\t=1", "'＝1", "plain"]
