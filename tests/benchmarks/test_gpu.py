"""The benchmark of a GPU: its parts at a tiny size, its table, and what it refuses; no GPU is needed."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
import torch

from benchmarks.gpu import benchmark, depth, networks, splats, training
from benchmarks.gpu.bringing import EXTRAS, ROOT, describe_needs
from benchmarks.gpu.machine import Machine, Stopwatch
from benchmarks.gpu.quantities import BUDGETS_S, METHODS, Measurement, PartResult, full_part, list_quantities
from benchmarks.gpu.streets import StreetData
from benchmarks.gpu.table import ABSENT, PAGE, make_table, read_measurements, write_table
from benchmarks.gpu.training import reached_s
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import write_json

TINY = Machine("cpu", 2e-4)


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts repeat their calls as rarely as they can."""
    for module in (splats, training, networks, depth):
        monkeypatch.setattr(module, "BUDGETS_S", dict.fromkeys(BUDGETS_S, 0.0))
    monkeypatch.setattr(training, "_TIMED", 1)


def names(part: str) -> list[str]:
    return [one.name for one in list_quantities() if one.part == part]


def test_quantities_have_names_of_their_own_and_budgets_of_four_minutes() -> None:
    keys = [one.key for one in list_quantities()]
    assert len(set(keys)) == len(keys)
    assert {one.part for one in list_quantities()} == {*BUDGETS_S, *map(full_part, METHODS)}
    assert sum(BUDGETS_S.values()) <= 240.0


def test_a_machine_scales_counts_and_pixels() -> None:
    whole, small = Machine("cpu"), Machine("cpu", 0.01)
    assert (whole.count(7000), whole.size_px(), small.count(7000), small.size_px()) == (7000, (960, 540), 70, (96, 54))
    assert small.size_px(448, 256, multiple=8) == (48, 24)
    assert not whole.is_gpu and set(whole.slug) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")


def test_a_stopwatch_measures_functions_and_gives_them_back() -> None:
    stopwatch, before = Stopwatch(TINY), torch.add
    with stopwatch.watching({"sum": (torch, "add")}):
        assert float(torch.add(torch.ones(()), torch.ones(()))) == 2.0
        with pytest.raises(TypeError):
            torch.add()  # type: ignore[call-overload]
    assert torch.add is before and stopwatch.total_ms["sum"] > 0.0


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize(
    ("part", "measure"),
    [
        ("rasterizer", splats.measure_rasterizer),
        ("frames", splats.measure_frames),
        ("depth", depth.measure_depth),
        ("step", training.measure_step),
        ("generation", networks.measure_generation),
    ],
)
def test_a_part_measures_what_the_table_lists(part: str, measure) -> None:
    found = measure(TINY)
    absent = set(names(part)) - set(found)
    assert set(found) <= set(names(part)) and all(
        value > 0.0 for name, value in found.items() if "overhead" not in name and "not that" not in name
    )
    assert all("gsplat called directly" in name for name in absent)
    for form in (training.StreetTrainer.step, training.street_module.rasterization, torch.Tensor.backward):
        assert "Stopwatch" not in form.__qualname__


def test_a_frame_has_the_operations_of_its_network() -> None:
    """The reference is one pass by hand: a linear layer of n x m has 2 n m operations a row."""
    layer = torch.nn.Linear(30, 50, device="meta")
    with networks.FlopCounterMode(display=False) as counter:
        layer(torch.zeros(7, 30, device="meta"))
    assert counter.get_total_flops() == 2 * 7 * 30 * 50
    with torch.device("meta"):
        count = sum(one.numel() for one in networks.Transformer(networks.SMALL).parameters())
    assert 55e6 < count < 65e6


def test_times_to_a_quality_are_read_between_rows() -> None:
    rows = [{"wall_s": 10.0, "psnr_db": 20.0}, {"wall_s": 20.0, "psnr_db": 26.0}, {"wall_s": 30.0, "psnr_db": 25.0}]
    assert reached_s(rows, 23.0) == pytest.approx(15.0)
    assert reached_s(rows, 20.0) == 10.0 and reached_s(rows, 26.5) is None and reached_s([], 1.0) is None


def test_the_table_shows_what_was_measured_and_nothing_else(tmp_path: Path) -> None:
    empty = make_table([])
    assert empty.count(ABSENT) == len(list(list_quantities()))
    part = PartResult(seconds=1.0, budget_s=2.0, values={"1 M Gaussians, image": 3.25})
    measured = Measurement(device="NVIDIA A", versions={"torch": "2"}, scale=1.0, parts={"rasterizer": part})
    write_json(tmp_path / "gpu" / "nvidia-a.json", measured)
    assert read_measurements(tmp_path / "gpu") == [measured]
    page = tmp_path / "page.md"
    page.write_text(PAGE.read_text())
    write_table(page, tmp_path / "gpu")
    written = page.read_text()
    assert "| rasterizer: 1 M Gaussians, image | ms | 3.25 |" in written and "| NVIDIA A |" in written
    assert written.count(ABSENT) >= len(list(list_quantities())) - 1
    page.write_text("nothing")
    with pytest.raises(DatasetError, match="no place for the table"):
        write_table(page, tmp_path / "gpu")


def test_the_page_has_the_table_of_the_documents() -> None:
    assert make_table(read_measurements()) in PAGE.read_text(), "run `python -m benchmarks gpu --table`"


def test_what_to_bring_names_the_street_the_wheels_and_every_call(tmp_path: Path) -> None:
    (tmp_path / "images").write_bytes(bytes(3_000_000))
    said = describe_needs(StreetData(tmp_path, "tiny"))
    assert f"({tmp_path}, 0.00 GB)" in said and f"torch {torch.__version__}" in said
    for command in ("pip download --dest wheels torch", "gsplat==1.5.3", "-e '.[models,gpu]'"):
        assert command in said
    for method in METHODS:
        assert f"python -m benchmarks gpu --full {method}" in said
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRAS.split(",")) <= set(extras)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--device", "cpu"], "the full size needs a GPU.*--scale 0.01 --device cpu"),
        (["--device", "cpu", "--scale", "2"], "--scale: 2; expected more than 0"),
        (
            ["--device", "cpu", "--scale", "0.1", "--only", "speed"],
            "--only: 'speed'; expected checks, depth",
        ),
        (["--device", "cpu", "--scale", "0.1", "--full", "nerf"], "--full: 'nerf'; expected hybridworldsim"),
    ],
)
def test_wrong_options_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        benchmark.main(words)
