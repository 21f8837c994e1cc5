"""Loads published checkpoints strictly by key, and finds out their generation."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

from hybridworldsim.petr.boxes import Generation
from hybridworldsim.petr.detector import Backbone
from mirror.errors import UsageError
from mirror.weights.resolve import file_sha256

_OLD_NAMES: Final = (
    (".self_attn.", ".attentions.0."),
    (".multihead_attn.", ".attentions.1."),
    (".decoder.norm.", ".decoder.post_norm."),
)
_MOST_NAMED: Final = 4


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint of PETR.

    Attributes:
        path: the file.
        sha256: its hash.
        state: tensors by name.
        generation: order of width and length in the codes of boxes.
        backbone: which backbone its names are of.
        multiview: whether it has the encoding of the camera's number.
    """

    path: Path
    sha256: str
    state: Mapping[str, Tensor]
    generation: Generation
    backbone: Backbone
    multiview: bool


def read_checkpoint(path: Path, *, sha256: str | None = None, generation: Generation | None = None) -> Checkpoint:
    """Read a checkpoint.

    The generation comes from the versions that the checkpoint states: ``mmdet3d_version`` below 1 is `width-length`; 1
    and above, and checkpoints of mmengine, are `length-width`.

    Args:
        path: the ``.pth`` file; it is read without unpickling code.
        sha256: expected hash; None: any.
        generation: replaces what the checkpoint states.

    Raises:
        UsageError: the file is missing, broken, another one, or does not state its generation.
    """
    if not path.is_file():
        raise UsageError(
            "no such file", file=path, expected="a checkpoint of PETR (.pth)", remedy="give it: --set weights=FILE"
        )
    digest = file_sha256(path)
    if sha256 is not None and digest != sha256:
        raise UsageError(f"sha256 {digest}", file=path, expected=sha256, remedy="download the file again")
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise UsageError(
            f"cannot be read as a checkpoint ({type(error).__name__}: {str(error)[:120]})",
            file=path,
            expected="a file of tensors that torch.load reads with weights_only=True",
        ) from error
    state = document.get("state_dict", document) if isinstance(document, dict) else None
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise UsageError("no tensors by name", file=path, expected="`state_dict`, or tensors by name")
    renamed = {_rename(name): value for name, value in state.items()}
    found = generation or _generation(document.get("meta"), document)
    if found is None:
        raise UsageError(
            "the checkpoint does not state the version of mmdetection3d that made it",
            file=path,
            expected="meta.mmdet3d_version",
            remedy="state it: --set generation=width-length for versions below 1, else length-width",
        )
    backbone: Backbone = "vovnet99" if "img_backbone.stem.stem_1/conv.weight" in renamed else "resnet50"
    multiview = "pts_bbox_head.adapt_pos3d.0.weight" in renamed
    return Checkpoint(path, digest, renamed, found, backbone, multiview)


def load_strictly(network: nn.Module, checkpoint: Checkpoint) -> None:
    """Load a checkpoint by key; every key and every shape must agree.

    Raises:
        UsageError: keys are missing or unexpected, shapes differ, or a tensor holds numbers that are not finite.
    """
    own = network.state_dict()
    missing = sorted(set(own) - set(checkpoint.state))
    unexpected = sorted(set(checkpoint.state) - set(own))
    shapes = [
        f"{name} {tuple(checkpoint.state[name].shape)}, not {tuple(own[name].shape)}"
        for name in sorted(set(own) & set(checkpoint.state))
        if own[name].shape != checkpoint.state[name].shape
    ]
    broken = [name for name, value in checkpoint.state.items() if not bool(torch.isfinite(value.float()).all())]
    problems = [
        f"{len(names)} {what}: {', '.join(names[:_MOST_NAMED])}{' ...' if len(names) > _MOST_NAMED else ''}"
        for what, names in (
            ("missing", missing), ("unexpected", unexpected), ("of another shape", shapes), ("not finite", broken)
        )
        if names
    ]  # fmt: skip
    if problems:
        raise UsageError(
            "; ".join(problems),
            file=checkpoint.path,
            expected=f"the {len(own)} tensors of PETR with backbone {checkpoint.backbone}",
            remedy="take a checkpoint of this backbone; deformable convolutions are not supported",
        )
    network.load_state_dict(dict(checkpoint.state), strict=True)


def _rename(name: str) -> str:
    """The present name of a tensor of a transformer before its version 2."""
    if ".transformer." in name:
        for old, new in _OLD_NAMES:
            if old == ".self_attn." or old == ".multihead_attn.":
                # The old module was torch's own attention, without `.attn.` around it.
                name = re.sub(re.escape(old) + r"(?!attn\.)", new + "attn.", name)
            name = name.replace(old, new)
    return name


def _generation(meta: Any, document: Mapping[str, Any]) -> Generation | None:
    stated = meta if isinstance(meta, dict) else {}
    version = stated.get("mmdet3d_version")
    if isinstance(version, str) and re.match(r"\d+\.", version):
        return "width-length" if int(version.split(".")[0]) < 1 else "length-width"
    if "mmengine_version" in stated or "message_hub" in document:
        return "length-width"
    return None
