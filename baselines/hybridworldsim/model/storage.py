"""A block on disk: one safetensors file that holds only what rendering needs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from pydantic import BaseModel, Json
from torch import Tensor

from hybridworldsim.light.recorded_light import LightDocument, light_from
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.street import StreetModel
from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.run.state import load
from mirror.errors import DatasetError
from mirror.schema.files import parse_json, write_bytes

FORMAT: Final = "hybridworldsim.block/2"
_ENTRY: Final = "hybridworldsim"
_TABLES: Final = ("offsets", "codes", "log_scales", "quats", "logits")


class FormatEntry(BaseModel):
    """The format that the metadata of a file states."""

    format: str | None = None


class BlockEntry(BaseModel):
    """The metadata of a block's file: a JSON object whose values are JSON texts."""

    block: Json[Block]
    radius_m: float
    sources: Json[list[Source]]
    about: Json[dict[str, Any]]
    light: Json[LightDocument] | None = None


def save_block(
    path: Path, block: Block, street: StreetModel, *, half: bool = False, about: Mapping[str, Any] | None = None
) -> int:
    """Write a block. An anchor has 50 numbers (place, k = 3 offsets, code of 32, 6 sizes): 200 bytes.

    In half precision, positions, networks and latents stay float32, and an anchor takes 106 bytes.

    Args:
        path: the file; it is written completely or not at all.
        block: place and size of the block.
        street: the model.
        half: store the tables that are not positions as float16.
        about: further JSON data: settings, hashes.

    Returns:
        Size of the file, bytes.

    Raises:
        DatasetError: a number is not finite, or too large for half precision.
    """
    from safetensors.torch import save

    tables = {name: _to_stored(name, parameter, half, path) for name, parameter in street.named_parameters()}
    metadata = {
        "format": FORMAT,
        "block": json.dumps(asdict(block)),
        "radius_m": repr(street.background.radius_m),
        "sources": json.dumps([tuple(source) for source in street.appearance.sources]),
        "about": json.dumps(dict(about or {}), sort_keys=True),
    }
    if street.light is not None:
        metadata["light"] = street.light.document().model_dump_json()
    # One entry, because safetensors writes several entries in any order, and equal models must have equal bytes.
    data = save(tables, {_ENTRY: json.dumps(metadata, sort_keys=True)})
    write_bytes(path, data)
    return len(data)


def load_block(path: Path) -> tuple[Block, StreetModel, dict[str, Any]]:
    """Read a block that `save_block` wrote.

    Returns:
        The block, its street in float32, and the further data that was stored with it.

    Raises:
        DatasetError: the file is missing, cannot be read, or has another format.
        SchemaError: its metadata are not those of a block.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "pt") as file:
            text = (file.metadata() or {}).get(_ENTRY, "{}").encode()
            stated = parse_json(text, FormatEntry, path).format
            if stated != FORMAT:
                raise DatasetError(f"format {stated!r}", file=path, expected=FORMAT)
            entry = parse_json(text, BlockEntry, path)
            tables = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (OSError, SafetensorError) as error:
        raise DatasetError(f"cannot be read: {error}", file=path, expected=f"a block, {FORMAT}") from error
    street = _empty_street(tables, entry.radius_m, entry.sources, entry.light)
    load(street, {f"model.{name}": table for name, table in tables.items()})
    return entry.block, street, entry.about


def _to_stored(name: str, parameter: Tensor, half: bool, path: Path) -> Tensor:
    table = parameter.detach().contiguous()
    if half and name.rpartition(".")[2] in _TABLES:
        table = table.half()
    if not torch.isfinite(table).all():
        raise DatasetError(
            "a number is not finite" + (", or too large for half precision" if half else ""), file=path, place=name,
            remedy="train again from the last checkpoint" + (", or store float32" if half else ""),
        )  # fmt: skip
    return table


def _empty_street(
    tables: Mapping[str, Tensor], radius_m: float, sources: list[Source], light: LightDocument | None
) -> StreetModel:
    """A street of the stored sizes whose tables have no rows."""
    latent = tables["appearance.drives"].shape[1]
    no_rows = torch.empty(0, 3)
    with torch.random.fork_rng(devices=[]):
        background = Anchors(
            no_rows,
            torch.empty(0),
            radius_m,
            offsets=tables["background.offsets"].shape[1],
            code=tables["background.codes"].shape[1],
            latent=latent,
            hidden=tables["background.geometry.out.weight"].shape[1],
        )
        ground, sky = (
            CodeGaussians(
                Seeds(no_rows, torch.empty(0, 4), no_rows, 0.5),
                tables[f"{name}.codes"].shape[1],
                latent,
                tables[f"{name}.colour.out.weight"].shape[1],
            )
            for name in ("ground", "sky")
        )
        recorded = None if light is None else light_from(light)
        return StreetModel(background, ground, sky, AppearanceLatents(sources, latent), recorded)
