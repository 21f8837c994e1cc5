"""Names and shapes of the tensors of OpenDWM's released models, written as rules.

`keys`: the 1,443 of CTSD on Stable Diffusion 3.5, facts of the released file. `unimlvg_keys`: the 1,034 of UniMLVG on
Stable Diffusion 3: by its released configuration it has no norms of queries and keys, no second attention, temporal
blocks behind the layers of the cross-view blocks, a smaller table of positions, and rays in place of camera numbers.
Independent of our modules: W stands for the width (1536), H for a head (64).
"""

from __future__ import annotations

from collections.abc import Sequence

W, H, TEXT, POOLED = 1536, 64, 4096, 2048
DUAL = range(13)
LAYERS = range(24)
TEMPORAL = (2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23)
CROSS_VIEW = (1, 5, 9, 13, 17, 21)


def keys(
    w: int = W,
    h: int = H,
    text: int = TEXT,
    pooled: int = POOLED,
    grid: int = 384,
    *,
    dual: Sequence[int] = DUAL,
    temporal: Sequence[int] = TEMPORAL,
) -> dict[str, tuple[int, ...]]:
    """Shapes by name; other sizes give a small model with the same names."""
    shapes: dict[str, tuple[int, ...]] = {}

    def linear(name: str, out: int, into: int, *, bias: bool = True) -> None:
        shapes[f"{name}.weight"] = (out, into)
        if bias:
            shapes[f"{name}.bias"] = (out,)

    def two_layers(name: str, into: int, hidden: int) -> None:
        linear(f"{name}.linear_1", hidden, into)
        linear(f"{name}.linear_2", w, hidden)

    def feed_forward(name: str, *, gated: bool = False) -> None:
        linear(f"{name}.net.0.proj", (8 if gated else 4) * w, w)
        linear(f"{name}.net.2", w, 4 * w)

    shapes["pos_embed.pos_embed"] = (1, grid * grid, w)
    shapes["pos_embed.proj.weight"], shapes["pos_embed.proj.bias"] = (w, 16, 2, 2), (w,)
    two_layers("time_text_embed.timestep_embedder", 256, w)
    two_layers("time_text_embed.text_embedder", pooled, w)
    linear("context_embedder", w, text)
    for layer in LAYERS:
        block, last = f"transformer_blocks.{layer}", layer == LAYERS[-1]
        linear(f"{block}.norm1.linear", (9 if layer in dual else 6) * w, w)
        linear(f"{block}.norm1_context.linear", (2 if last else 6) * w, w)
        for attention in ("attn", "attn2") if layer in dual else ("attn",):
            for part in ("to_q", "to_k", "to_v", "to_out.0"):
                linear(f"{block}.{attention}.{part}", w, w)
            for part in ("norm_q", "norm_k"):
                shapes[f"{block}.{attention}.{part}.weight"] = (h,)
        for part in ("add_q_proj", "add_k_proj", "add_v_proj") + (() if last else ("to_add_out",)):
            linear(f"{block}.attn.{part}", w, w)
        for part in ("norm_added_q", "norm_added_k"):
            shapes[f"{block}.attn.{part}.weight"] = (h,)
        feed_forward(f"{block}.ff")
        if not last:
            feed_forward(f"{block}.ff_context")
    linear("norm_out.linear", 2 * w, w)
    linear("proj_out", 64, w)
    for place in range(6):
        body = f"condition_image_adapter.body.{place}"
        if place == 0 and w != 384:
            shapes[f"{body}.in_conv.weight"], shapes[f"{body}.in_conv.bias"] = (w, 384, 1, 1), (w,)
        for unit in range(2):
            for number, side in ((1, 3), (2, 1)):
                shapes[f"{body}.resnets.{unit}.block{number}.weight"] = (w, w, side, side)
                shapes[f"{body}.resnets.{unit}.block{number}.bias"] = (w,)
        shapes[f"condition_image_adapter.zero_convs.{place}.weight"] = (w, w, 1, 1)
        shapes[f"condition_image_adapter.zero_convs.{place}.bias"] = (w,)
    two_layers("view_embedding", 11 * 256, w)
    for axis, kind, layers in (("view", "crossview", CROSS_VIEW), ("time", "temporal", temporal)):
        for place in range(len(layers)):
            two_layers(f"{axis}_pos_embeds.{place}", w, 4 * w)
            shapes[f"{axis}_mixers.{place}.mix_factor"] = (1,)
            block = f"{kind}_transformer_blocks.{place}"
            for norm in ("norm_in", "norm1", "norm3"):
                shapes[f"{block}.{norm}.weight"] = shapes[f"{block}.{norm}.bias"] = (w,)
            feed_forward(f"{block}.ff_in", gated=True)
            feed_forward(f"{block}.ff", gated=True)
            for part in ("to_q", "to_k", "to_v"):
                linear(f"{block}.attn1.{part}", w, w, bias=False)
            linear(f"{block}.attn1.to_out.0", w, w)
            for part in ("norm_q", "norm_k"):
                shapes[f"{block}.attn1.{part}.weight"] = (h,)
    return shapes


def unimlvg_keys(
    w: int = W, h: int = H, text: int = TEXT, pooled: int = POOLED, grid: int = 192
) -> dict[str, tuple[int, ...]]:
    """Shapes by name of UniMLVG; other sizes as in `keys`."""
    shapes = keys(w, h, text, pooled, grid, dual=(), temporal=CROSS_VIEW)
    norms = ("norm_q.weight", "norm_k.weight", "norm_added_q.weight", "norm_added_k.weight")
    kept = {
        name: shape
        for name, shape in shapes.items()
        if not name.endswith(norms) and not name.startswith("view_embedding.")
    }
    # An origin in 8 octaves and a direction in 4: a sine and a cosine of three numbers each.
    return kept | {"rayencoder.proj.weight": (w, 2 * 3 * (8 + 4))}
