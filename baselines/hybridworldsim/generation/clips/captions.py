"""Embedded captions: text enters the network as vectors that were computed elsewhere; an empty text needs none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import torch
from torch import Tensor

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.network.checkpoints import read_weights
from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.errors import UsageError
from mirror.weights.errors import WeightsUnavailableError

ALL: Final = "all"
"""Name of the caption of all views that have none of their own, in a file of embeddings."""
_FORM: Final = "NAME/tokens and NAME/pooled for each caption"


@dataclass(frozen=True, eq=False)
class TextEmbedding:
    """The embedding of one caption, or of several captions along leading axes.

    Attributes:
        tokens: (M, text_channels); M may be 0.
        pooled: (pooled_channels,).
    """

    tokens: Tensor
    pooled: Tensor

    @classmethod
    def empty(cls, config: TransformerConfig) -> TextEmbedding:
        """Make an empty text: no tokens, and zeros for the pooled vector."""
        return cls(torch.zeros(0, config.text_channels), torch.zeros(config.pooled_channels))


class Captions(Protocol):
    """A source of the caption of each frame: a file (`CachedCaptions`), or a model that describes images."""

    def __call__(self, clip: Clip, frame: int, view: str) -> TextEmbedding:
        """The embedded caption of a view of a frame; all must have as many tokens."""
        ...


def embed_views(captions: Captions, clip: Clip, frame: int, config: TransformerConfig) -> TextEmbedding:
    """Return the embedded captions of all views of a frame: tokens (V, M, text_channels), pooled (V, pooled_channels).

    Raises:
        UsageError: a caption has another size than the network takes, or another number of tokens than the others.
    """
    embeddings = [captions(clip, frame, view) for view in clip.views]
    for view, one in zip(clip.views, embeddings):
        shapes = tuple(one.tokens.shape), tuple(one.pooled.shape)
        wanted = (len(embeddings[0].tokens), config.text_channels), (config.pooled_channels,)
        if shapes != wanted:
            raise UsageError(
                f"a caption of {shapes[0]} and {shapes[1]} numbers", place=f"{clip.clip_id}, frame {frame}, {view}",
                expected=f"{wanted[0]} and {wanted[1]}, as the network and the other views",
            )  # fmt: skip
    return TextEmbedding(
        torch.stack([one.tokens for one in embeddings]), torch.stack([one.pooled for one in embeddings])
    )


def require_equal_lengths(texts: Iterable[Tensor]) -> None:
    """Check that the texts (..., M, channels) of frames that are to be joined have equally many tokens.

    Raises:
        UsageError: they have not.
    """
    lengths = sorted({one.shape[-2] for one in texts})
    if len(lengths) > 1:
        raise UsageError(
            f"captions of {' and '.join(map(str, lengths))} tokens", expected="as many tokens in all frames",
            remedy="pad texts to one length before they are embedded",
        )  # fmt: skip


def embedding_widths(path: Path) -> tuple[int, int]:
    """Return the widths of tokens and of pooled embeddings in a file of embeddings.

    Raises:
        WeightsUnavailableError: the file is missing or broken, or its embeddings differ in width.
    """
    tensors = read_weights(path)
    widths = [
        {tensor.shape[-1] for name, tensor in tensors.items() if name.endswith(f"/{part}") and tensor.dim() == dims}
        for part, dims in (("tokens", 2), ("pooled", 1))
    ]
    if any(len(one) != 1 for one in widths):
        found = " and ".join(", ".join(map(str, sorted(one))) or "none" for one in widths)
        raise WeightsUnavailableError(f"embeddings of the widths {found}", file=path, expected=f"one width: {_FORM}")
    return widths[0].pop(), widths[1].pop()


class CachedEmbeddings:
    """Embeddings by name in a safetensors file: ``NAME/tokens`` (M, text_channels), ``NAME/pooled`` (pooled_channels,).

    Names are captions, or what `CachedCaptions` looks for. All have the same M.

    Args:
        path: the file.
        config: network that the embeddings are for.

    Raises:
        WeightsUnavailableError: the file is missing or broken, or an embedding is incomplete, not finite or of another
            size.
    """

    def __init__(self, path: Path, config: TransformerConfig) -> None:
        tensors = read_weights(path)
        self.path, self._empty = path, TextEmbedding.empty(config)
        parts: dict[str, dict[str, Tensor]] = {}
        for key, tensor in tensors.items():
            name, slash, part = key.rpartition("/")
            if not slash or part not in ("tokens", "pooled"):
                raise WeightsUnavailableError(f"a tensor {key!r}", file=path, expected=_FORM)
            parts.setdefault(name, {})[part] = tensor
        if not parts:
            raise WeightsUnavailableError("no embeddings", file=path, expected=_FORM)
        self._embeddings = {name: self._read(name, parts[name], config) for name in sorted(parts)}
        lengths = sorted({len(one.tokens) for one in self._embeddings.values()})
        if len(lengths) > 1:
            raise WeightsUnavailableError(
                f"captions of {' and '.join(map(str, lengths))} tokens", file=path, expected="as many tokens in all",
                remedy="pad texts to one length before they are embedded",
            )  # fmt: skip

    def _read(self, name: str, parts: dict[str, Tensor], config: TransformerConfig) -> TextEmbedding:
        tokens, pooled = parts.get("tokens"), parts.get("pooled")
        if (
            tokens is None
            or pooled is None
            or tokens.dim() != 2
            or tokens.shape[1] != config.text_channels
            or pooled.shape != (config.pooled_channels,)
        ):
            found = ", ".join(f"{part} {tuple(tensor.shape)}" for part, tensor in sorted(parts.items()))
            raise WeightsUnavailableError(
                f"the embedding of {name!r} does not fit: {found}", file=self.path,
                expected=f"tokens (M, {config.text_channels}) and pooled ({config.pooled_channels},)",
            )  # fmt: skip
        for part, tensor in (("tokens", tokens), ("pooled", pooled)):
            if not tensor.is_floating_point() or not bool(tensor.isfinite().all()):
                raise WeightsUnavailableError(
                    "numbers that are not finite", file=self.path, place=f"{name}/{part}",
                    expected="finite floating point numbers",
                )  # fmt: skip
        return TextEmbedding(tokens.float(), pooled.float())

    def __contains__(self, name: str) -> bool:
        return name in self._embeddings

    def __call__(self, caption: str) -> TextEmbedding:
        """The embedding of a caption; that of an empty one need not be in the file.

        Raises:
            UsageError: the file has no such caption.
        """
        if caption in self._embeddings:
            return self._embeddings[caption]
        if not caption:
            return self._empty
        raise UsageError(
            f"no embedding of {caption!r}", file=self.path,
            expected=f"one of its {len(self._embeddings)} captions, or no text",
            remedy="embed it, and add it to the file",
        )  # fmt: skip


class CachedCaptions:
    """Captions of views, by name, from a file of embeddings; the same in all frames of a clip.

    The name of a view's caption is the first of these that the file has: ``CLIP/CAMERA``, ``CLIP``, ``CAMERA``,
    ``all``. In place of the clip's id that of its drive may stand; for a scene of a dataset this is the traversal.

    Args:
        path: the file.
        config: network that the embeddings are for.

    Raises:
        WeightsUnavailableError: as `CachedEmbeddings`.
    """

    def __init__(self, path: Path, config: TransformerConfig) -> None:
        self._embeddings = CachedEmbeddings(path, config)

    def require(self, clip_ids: tuple[str, ...], views: Iterable[str]) -> None:
        """Check that there is a caption for each view.

        Args:
            clip_ids: id of a clip and of its drive, or of a traversal.
            views: names of the cameras.

        Raises:
            UsageError: a view has none.
        """
        lost = [view for view in views if self._name(clip_ids, view) is None]
        if lost:
            raise UsageError(
                f"no caption for {', '.join(lost)}", file=self._embeddings.path, place="--captions",
                expected=f"CAMERA/tokens and CAMERA/pooled for each camera, or those of {ALL!r}; also behind "
                f"{clip_ids[0]}/",
            )  # fmt: skip

    def __call__(self, clip: Clip, frame: int, view: str) -> TextEmbedding:
        """The caption of a view."""
        name = self._name((clip.clip_id, clip.drive_id), view)
        if name is None:
            raise UsageError(f"no caption for {view}", file=self._embeddings.path, place=clip.clip_id)
        return self._embeddings(name)

    def _name(self, clip_ids: tuple[str, ...], view: str) -> str | None:
        names = [*(f"{one}/{view}" for one in clip_ids), *clip_ids, view, ALL]
        return next((name for name in names if name in self._embeddings), None)
