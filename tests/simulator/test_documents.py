"""The Python of docs/simulation.md and docs/simulation/policies.md runs; walls of the street that it opens."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.run import RolloutRequest, run_rollout
from hybridworldsim.simulator.street.obstacles import Walls, check_free
from hybridworldsim.simulator.street.opening import open_street
from mirror.errors import UsageError
from tests.simulator.streets import scenario, straight_street

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "simulation.md").read_text() + (DOCS / "simulation" / "policies.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.S)


def test_a_drive_takes_ten_lines(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for line in BLOCKS[0].splitlines() if line and not line.startswith("import")]
    assert len(lines) <= 10
    exec(BLOCKS[0], {})
    ending, shape = capsys.readouterr().out.strip().split(" ", 1)
    assert ending in ("duration", "collision", "route_end", "left_street")
    assert shape.endswith(", 240, 3)")


def test_the_policy_of_the_page_drives(tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    exec(BLOCKS[1], names)
    street = straight_street()
    request = RolloutRequest(
        street, scenario(duration_s=1.0), names["Careful"](), "careful", rig_cameras(street, ("front_wide",), 32),
        RendererFactory("boxes"),
    )  # fmt: skip
    result = run_rollout(replace(request), tmp_path / "run")
    assert result.error is None
    assert result.rollout.steps == 10
    assert result.rendered == 11


def test_an_agent_inside_a_wall_is_refused() -> None:
    street = open_street("synth:tiny")
    walls = Walls.of(street)
    places = np.random.default_rng(0).uniform(-55.0, 55.0, (40, 2))
    inside = [place for place in places if walls.find(place[None]) is not None]
    assert 5 < len(inside) < 30
    with pytest.raises(UsageError, match="starts in a building") as caught:
        check_free(street, walls, "walker", "pedestrian", np.array([*inside[0], 0.0, 0.3, 0.3]))
    assert "walker" in str(caught.value)
    way = next(iter(street.road_map.lanes_of())).center_m
    assert walls.find(way[:5, :2]) is None
