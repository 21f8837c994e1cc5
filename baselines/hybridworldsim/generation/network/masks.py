"""Which tokens may attend to which: earlier frames only, adjacent views only, and existing views only."""

from __future__ import annotations

import torch
from torch import Tensor


def temporal_mask(
    present: Tensor | None,
    earlier_present: Tensor | None,
    *,
    shape: tuple[int, int, int],
    earlier: int,
    causal: bool,
    tokens: int,
    pointwise: bool,
    device: torch.device,
) -> Tensor | None:
    """Return the mask of a temporal block.

    Args:
        present: (B, T, V) which views exist; None: all.
        earlier_present: (B, earlier, V) which views of the earlier frames exist; None: all.
        shape: B, T and V.
        earlier: number of earlier frames, whose keys stand before those of the T frames.
        causal: whether a frame attends only to itself and to earlier ones.
        tokens: tokens of an image.
        pointwise: whether each token is a sequence of its own; else all tokens of all frames are one sequence.
        device: of the result.

    Returns:
        True where a query may attend to a key, or None if all may. Shape (B * V * tokens, 1, T, earlier + T), with
        ``tokens`` in the last two axes instead of the first if not ``pointwise``; an axis of B * V may be 1.
    """
    batch, frames, views = shape
    allowed: Tensor | None = None
    if causal and frames > 1:
        query = torch.arange(frames, device=device)[:, None] + earlier
        allowed = (torch.arange(earlier + frames, device=device) <= query).expand(1, 1, -1, -1)
    if present is not None or earlier_present is not None:
        now = torch.ones(shape, dtype=torch.bool, device=device) if present is None else present
        if earlier:
            missing = torch.ones((batch, earlier, views), dtype=torch.bool, device=device)
            now = torch.cat([missing if earlier_present is None else earlier_present, now], dim=1)
        keys = now.transpose(1, 2).reshape(batch * views, 1, 1, earlier + frames)
        # A view that does not exist attends to itself, so that its unused result is finite.
        own = torch.eye(earlier + frames, dtype=torch.bool, device=device)[earlier:]
        existing = keys | own
        allowed = existing if allowed is None else (existing & allowed) | own
    if allowed is None:
        return None
    if pointwise:
        return allowed if len(allowed) == 1 else allowed.repeat_interleave(tokens, dim=0)
    return allowed.repeat_interleave(tokens, dim=2).repeat_interleave(tokens, dim=3)


def cross_view_mask(
    present: Tensor | None, adjacent: Tensor | None, *, shape: tuple[int, int, int], rows: int, columns: int
) -> Tensor | None:
    """Return the mask of a cross-view block.

    Args:
        present: (B, T, V) which views exist; None: all.
        adjacent: (B, V, V) whether a view (row) attends to another (column); None: all to all.
        shape: B, T and V.
        rows: rows of tokens of an image; each row is a sequence.
        columns: tokens of a row.

    Returns:
        (B * T * rows, 1, V * columns, V * columns) True where a query may attend to a key, or None if all may.
    """
    batch, frames, views = shape
    allowed: Tensor | None = None
    if adjacent is not None:
        allowed = adjacent[:, None].expand(batch, frames, views, views)
    if present is not None:
        existing = present[:, :, None].expand(batch, frames, views, views)
        allowed = existing if allowed is None else allowed & existing
    if allowed is None:
        return None
    allowed = allowed | torch.eye(views, dtype=torch.bool, device=allowed.device)
    allowed = allowed.reshape(batch * frames, 1, views, views)
    allowed = allowed.repeat_interleave(columns, dim=2).repeat_interleave(columns, dim=3)
    return allowed.repeat_interleave(rows, dim=0)
