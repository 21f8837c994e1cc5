from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.storage import FORMAT, load_block, save_block
from hybridworldsim.trainable.viewpoint import Source, to_viewpoint
from mirror.errors import DatasetError, SchemaError
from mirror.metrics.images.psnr import psnr
from tests.model.streets import SOURCES, street, view

BLOCK = Block((1, 2), (441_000.123456789, 4_475_000.1, 612.7))


def test_stored_street_is_restored(tmp_path: Path) -> None:
    trained_street = street()
    size = save_block(tmp_path / "model.safetensors", BLOCK, trained_street, about={"seed": 3})
    assert size == (tmp_path / "model.safetensors").stat().st_size
    block, other, about = load_block(tmp_path / "model.safetensors")
    assert (block, about) == (BLOCK, {"seed": 3})
    assert other.appearance.sources == trained_street.appearance.sources
    assert other.background.radius_m == trained_street.background.radius_m
    for (name, ours), (again, theirs) in zip(trained_street.named_parameters(), other.named_parameters(), strict=True):
        assert name == again and torch.equal(ours, theirs)


@pytest.mark.parametrize(("half", "anchor", "plain"), [(False, 284, 108), (True, 148, 60)])
def test_stored_size_is_that_of_the_numbers(tmp_path: Path, half: bool, anchor: int, plain: int) -> None:
    few, many = street(100), street(1100)
    sizes = [
        save_block(tmp_path / f"{len(trained_street.background)}", BLOCK, trained_street, half=half)
        for trained_street in (few, many)
    ]
    # Offsets in the header have more digits.
    assert 0 <= sizes[1] - sizes[0] - 1000 * anchor <= 128
    more = street(100)
    for name, table in list(more.ground.named_parameters(recurse=False)):
        setattr(more.ground, name, torch.nn.Parameter(table.detach().repeat(2, *[1] * (table.ndim - 1))))
    assert 0 <= save_block(tmp_path / "ground", BLOCK, more, half=half) - sizes[0] - 400 * plain <= 128


def test_half_precision_hardly_changes_a_render(tmp_path: Path) -> None:
    trained_street = street()
    save_block(tmp_path / "half", BLOCK, trained_street, half=True)
    _, other, _ = load_block(tmp_path / "half")
    viewpoint = to_viewpoint(view(-25.0), np.zeros(3))
    with torch.no_grad():
        renders = [each(viewpoint, each.appearance(SOURCES[0])).rgb.clamp(0, 1) for each in (trained_street, other)]
    ours, theirs = (image.mul(255.0).round().byte().numpy() for image in renders)
    assert psnr(ours, theirs) > 45.0


def test_numbers_that_cannot_be_stored_are_refused(tmp_path: Path) -> None:
    trained_street = street()
    trained_street.background.codes.data[0, 0] = 1e6
    with pytest.raises(DatasetError, match="too large for half precision"):
        save_block(tmp_path / "m", BLOCK, trained_street, half=True)
    trained_street.background.codes.data[0, 0] = torch.nan
    with pytest.raises(DatasetError, match=r"background\.codes: a number is not finite"):
        save_block(tmp_path / "m", BLOCK, trained_street)
    assert not (tmp_path / "m").exists()


def test_other_files_are_refused(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    with pytest.raises(DatasetError, match="cannot be read"):
        load_block(tmp_path / "none")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(DatasetError, match="cannot be read"):
        load_block(tmp_path / "text")
    save_file({"a": torch.zeros(1)}, tmp_path / "other")
    with pytest.raises(DatasetError, match="format None"):
        load_block(tmp_path / "other")
    entry = {"block": '{"index": [0, 0], "origin_m": [0, 0, 0]}', "radius_m": "1", "sources": "[]", "about": "{}"}
    broken = [
        {},
        *({**entry, name: "[" * 50_000} for name in entry),
        *({**entry, name: "7"} for name in ("block", "sources", "about")),
    ]
    for one in broken:
        save_file({"a": torch.zeros(1)}, tmp_path / "other", {"hybridworldsim": json.dumps({"format": FORMAT, **one})})
        with pytest.raises(SchemaError, match="other: "):
            load_block(tmp_path / "other")
    save_file({"a": torch.zeros(1)}, tmp_path / "other", {"hybridworldsim": "[" * 50_000})
    with pytest.raises(SchemaError, match="nested too deep"):
        load_block(tmp_path / "other")


def test_a_traversal_adds_one_latent_and_one_for_each_camera(tmp_path: Path) -> None:
    """Memory hardly grows with the number of traversals, in contrast to a set of colours for each traversal."""
    sizes = {}
    for traversals in (1, 2, 101):
        trained_street = street()
        sources = [Source(f"s.{number:03}.0", camera) for number in range(traversals) for camera in ("front", "rear")]
        trained_street.appearance = AppearanceLatents(sources, 8)
        sizes[traversals] = save_block(tmp_path / str(traversals), BLOCK, trained_street)
    # Three latents of 8 numbers; the header has the names of the two sources.
    each = (sizes[101] - sizes[1]) / 100
    assert 3 * 8 * 4 <= each <= 3 * 8 * 4 + 80
