"""CTSD written plainly in float64 with loops over images, heads and queries: an independent reference.

Reads a state dict by its released names; knows nothing of our modules.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from tests.generation.ctsd35_keys import CROSS_VIEW, DUAL, LAYERS, TEMPORAL

Array = np.ndarray
State = Mapping[str, Array]


def silu(x: Array) -> Array:
    return x / (1.0 + np.exp(-x))


def gelu(x: Array) -> Array:
    from math import erf, sqrt

    return x * np.vectorize(lambda value: 0.5 * (1.0 + erf(value / sqrt(2.0))))(x)


def gelu_tanh(x: Array) -> Array:
    return 0.5 * x * (1.0 + np.tanh(np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3)))


def normalise(x: Array, epsilon: float) -> Array:
    mean = x.mean(axis=-1, keepdims=True)
    return (x - mean) / np.sqrt(((x - mean) ** 2).mean(axis=-1, keepdims=True) + epsilon)


def root_mean_square(x: Array, weight: Array, epsilon: float) -> Array:
    return weight * x / np.sqrt((x**2).mean(axis=-1, keepdims=True) + epsilon)


def sinusoid(value: float, channels: int) -> Array:
    half = channels // 2
    angles = value * np.array([10_000.0 ** (-place / half) for place in range(half)])
    return np.concatenate([np.cos(angles), np.sin(angles)])


def attend(query: Array, key: Array, value: Array, heads: int, may: Callable[[int, int], bool]) -> Array:
    """(L, W), (K, W), (K, W); each head and each query on its own."""
    out = np.zeros_like(query)
    size = query.shape[1] // heads
    for head in range(heads):
        part = slice(head * size, (head + 1) * size)
        for row in range(len(query)):
            allowed = [column for column in range(len(key)) if may(row, column)]
            scores = key[allowed, part] @ query[row, part] / np.sqrt(size)
            weights = np.exp(scores - scores.max())
            out[row, part] = weights @ value[allowed, part] / weights.sum()
    return out


class Reference:
    """The network of one state dict; `frames` of `views` of one sequence."""

    def __init__(self, state: State, heads: int, *, causal: bool = False) -> None:
        self.state, self.heads, self.causal = state, heads, causal
        self.width = len(state["context_embedder.bias"])

    def linear(self, name: str, x: Array) -> Array:
        out = x @ self.state[f"{name}.weight"].T
        return out + self.state[f"{name}.bias"] if f"{name}.bias" in self.state else out

    def two_layers(self, name: str, x: Array) -> Array:
        return self.linear(f"{name}.linear_2", silu(self.linear(f"{name}.linear_1", x)))

    def heads_normed(self, name: str, x: Array, epsilon: float) -> Array:
        if f"{name}.weight" not in self.state:
            return x
        parts = np.split(x, self.heads, axis=-1)
        return np.concatenate([root_mean_square(one, self.state[f"{name}.weight"], epsilon) for one in parts], axis=-1)

    def joint(self, name: str, image: Array, text: Array, condition: Array) -> tuple[Array, Array]:
        last, dual = name.endswith(f".{LAYERS[-1]}"), int(name.rpartition(".")[2]) in DUAL
        parts = np.split(self.linear(f"{name}.norm1.linear", silu(condition)), 9 if dual else 6)
        shift, scale, gate, shift_ff, scale_ff, gate_ff = parts[:6]
        plain = normalise(image, 1e-6)
        of_text = np.split(self.linear(f"{name}.norm1_context.linear", silu(condition)), 2 if last else 6)
        text_scale, text_shift = of_text if last else (of_text[1], of_text[0])
        queries, keys, values = [], [], []
        for kind, x in (("image", plain * (1 + scale) + shift),
                        ("text", normalise(text, 1e-6) * (1 + text_scale) + text_shift)):  # fmt: skip
            names = ("to_q", "to_k", "to_v") if kind == "image" else ("add_q_proj", "add_k_proj", "add_v_proj")
            norms = ("norm_q", "norm_k") if kind == "image" else ("norm_added_q", "norm_added_k")
            queries.append(
                self.heads_normed(f"{name}.attn.{norms[0]}", self.linear(f"{name}.attn.{names[0]}", x), 1e-6)
            )
            keys.append(self.heads_normed(f"{name}.attn.{norms[1]}", self.linear(f"{name}.attn.{names[1]}", x), 1e-6))
            values.append(self.linear(f"{name}.attn.{names[2]}", x))
        mixed = attend(*(np.concatenate(x) for x in (queries, keys, values)), self.heads, lambda row, column: True)
        image = image + gate * self.linear(f"{name}.attn.to_out.0", mixed[: len(image)])
        if dual:
            shift_2, scale_2, gate_2 = parts[6:]
            x = plain * (1 + scale_2) + shift_2
            query = self.heads_normed(f"{name}.attn2.norm_q", self.linear(f"{name}.attn2.to_q", x), 1e-6)
            key = self.heads_normed(f"{name}.attn2.norm_k", self.linear(f"{name}.attn2.to_k", x), 1e-6)
            own = attend(query, key, self.linear(f"{name}.attn2.to_v", x), self.heads, lambda row, column: True)
            image = image + gate_2 * self.linear(f"{name}.attn2.to_out.0", own)
        hidden = gelu_tanh(self.linear(f"{name}.ff.net.0.proj", normalise(image, 1e-6) * (1 + scale_ff) + shift_ff))
        image = image + gate_ff * self.linear(f"{name}.ff.net.2", hidden)
        if not last:
            _, _, text_gate, text_shift_ff, text_scale_ff, text_gate_ff = of_text
            text = text + text_gate * self.linear(f"{name}.attn.to_add_out", mixed[len(image) :])
            x = normalise(text, 1e-6) * (1 + text_scale_ff) + text_shift_ff
            text = text + text_gate_ff * self.linear(
                f"{name}.ff_context.net.2", gelu_tanh(self.linear(f"{name}.ff_context.net.0.proj", x))
            )
        return image, text

    def mixing(self, name: str, tokens: Array, may: Callable[[int, int], bool]) -> Array:
        """(L, W) of one sequence."""

        def affine(norm: str, x: Array) -> Array:
            return normalise(x, 1e-5) * self.state[f"{name}.{norm}.weight"] + self.state[f"{name}.{norm}.bias"]

        def gated(part: str, x: Array) -> Array:
            values, gate = np.split(self.linear(f"{name}.{part}.net.0.proj", x), 2, axis=-1)
            return self.linear(f"{name}.{part}.net.2", values * gelu(gate))

        tokens = tokens + gated("ff_in", affine("norm_in", tokens))
        x = affine("norm1", tokens)
        query = self.heads_normed(f"{name}.attn1.norm_q", self.linear(f"{name}.attn1.to_q", x), 1e-5)
        key = self.heads_normed(f"{name}.attn1.norm_k", self.linear(f"{name}.attn1.to_k", x), 1e-5)
        mixed = attend(query, key, self.linear(f"{name}.attn1.to_v", x), self.heads, may)
        tokens = tokens + self.linear(f"{name}.attn1.to_out.0", mixed)
        return tokens + gated("ff", affine("norm3", tokens))

    def convolve(self, name: str, x: Array) -> Array:
        """(channels, rows, columns), with a border of zeros."""
        weight, bias = self.state[f"{name}.weight"], self.state[f"{name}.bias"]
        side = weight.shape[-1]
        rows, columns = x.shape[1:]
        padded = np.pad(x, ((0, 0), (side // 2, side // 2), (side // 2, side // 2)))
        out = np.zeros((len(weight), rows, columns))
        for row in range(rows):
            for column in range(columns):
                window = padded[:, row : row + side, column : column + side]
                out[:, row, column] = np.tensordot(weight, window, axes=3) + bias
        return out

    def adapter(self, image: Array) -> list[Array]:
        """One image (6, height, width) to six features (L, W)."""
        channels, height, width = image.shape
        x = np.zeros((channels * 64, height // 8, width // 8))
        for channel in range(channels):
            for dy in range(8):
                for dx in range(8):
                    x[channel * 64 + dy * 8 + dx] = image[channel, dy::8, dx::8]
        features = []
        for place in range(6):
            body = f"condition_image_adapter.body.{place}"
            if place == 0:
                x = 0.25 * (x[:, ::2, ::2] + x[:, 1::2, ::2] + x[:, ::2, 1::2] + x[:, 1::2, 1::2])
            if f"{body}.in_conv.weight" in self.state:
                x = self.convolve(f"{body}.in_conv", x)
            for unit in range(2):
                hidden = np.maximum(self.convolve(f"{body}.resnets.{unit}.block1", x), 0.0)
                x = x + self.convolve(f"{body}.resnets.{unit}.block2", hidden)
            feature = self.convolve(f"condition_image_adapter.zero_convs.{place}", x)
            features.append(feature.reshape(len(feature), -1).T)
        return features

    def rays(self, intrinsics: Array, camera_to_first: Array, rows: int, columns: int) -> Array:
        """(L, width) of the explicit camera condition: 8 octaves of the origin, 4 of the direction."""
        out = []
        for row in range(rows):
            for column in range(columns):
                pixel = np.array([(column + 0.5) / columns, (row + 0.5) / rows, 1.0])
                direction = camera_to_first[:3, :3] @ np.linalg.solve(intrinsics, pixel)
                direction = direction / np.linalg.norm(direction)
                numbers = []
                for vector, octaves in ((camera_to_first[:3, 3], 8), (direction, 4)):
                    angles = [2.0**octave * np.pi * value for value in vector for octave in range(octaves)]
                    numbers += [*np.sin(angles), *np.cos(angles)]
                out.append(self.state["rayencoder.proj.weight"] @ np.array(numbers))
        return np.array(out)

    def camera(self, rate_hz: float, intrinsics: Array, camera_to_ego: Array, aspect: float) -> Array:
        """(1, width) of the implicit camera condition."""
        numbers = [
            rate_hz, intrinsics[0, 0] * aspect, intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2],
            *camera_to_ego[:3, 2], *camera_to_ego[:3, 3],
        ]  # fmt: skip
        return self.two_layers("view_embedding", np.concatenate([sinusoid(value, 256) for value in numbers]))[None]

    def run(
        self,
        latents: Array,
        timestep: Array,
        text: Array,
        pooled: Array,
        cameras: list[list[Array]],
        layout: Array | None,
        present: Array,
        adjacent: Array,
    ) -> Array:
        """Latents (T, V, C, H, W), time steps (T, V), text (T, V, M, D), pooled (T, V, P), camera embeddings by frame
        and view, layout (T, V, 6, height, width), present (T, V), adjacent (V, V)."""
        state, width = self.state, self.width
        frames, views, channels, height, length = latents.shape
        rows, columns = height // 2, length // 2
        grid = round(state["pos_embed.pos_embed"].shape[1] ** 0.5)
        table = state["pos_embed.pos_embed"][0].reshape(grid, grid, width)
        top, left = (grid - rows) // 2, (grid - columns) // 2
        tokens = np.zeros((frames, views, rows * columns, width))
        texts = np.zeros((frames, views, text.shape[2], width))
        conditions = np.zeros((frames, views, width))
        features = (
            [[self.adapter(layout[t, v]) for v in range(views)] for t in range(frames)] if layout is not None else None
        )
        for t in range(frames):
            for v in range(views):
                for row in range(rows):
                    for column in range(columns):
                        patch = latents[t, v, :, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
                        token = (
                            np.tensordot(state["pos_embed.proj.weight"], patch, axes=3) + state["pos_embed.proj.bias"]
                        )
                        tokens[t, v, row * columns + column] = token + table[top + row, left + column]
                texts[t, v] = self.linear("context_embedder", text[t, v])
                conditions[t, v] = self.two_layers(
                    "time_text_embed.timestep_embedder", sinusoid(timestep[t, v], 256)
                ) + self.two_layers("time_text_embed.text_embedder", pooled[t, v])
        for layer in LAYERS:
            for t in range(frames):
                for v in range(views):
                    if features is not None and layer < 6:
                        tokens[t, v] += features[t][v][layer]
                    tokens[t, v], texts[t, v] = self.joint(
                        f"transformer_blocks.{layer}", tokens[t, v], texts[t, v], conditions[t, v]
                    )
            if layer in TEMPORAL:
                place = TEMPORAL.index(layer)
                mixed = np.zeros_like(tokens)
                for v in range(views):
                    for token in range(rows * columns):
                        sequence = np.stack(
                            [
                                tokens[t, v, token]
                                + self.two_layers(f"time_pos_embeds.{place}", sinusoid(t, width))
                                + cameras[t][v][min(token, len(cameras[t][v]) - 1)]
                                for t in range(frames)
                            ]
                        )
                        mixed[:, v, token] = self.mixing(
                            f"temporal_transformer_blocks.{place}",
                            sequence,
                            lambda row, column, v=v: (
                                row == column or (present[column, v] and (column <= row or not self.causal))
                            ),
                        )
                share = 1.0 / (1.0 + np.exp(-state[f"time_mixers.{place}.mix_factor"]))
                tokens = share * tokens + (1.0 - share) * mixed
            if layer in CROSS_VIEW:
                place = CROSS_VIEW.index(layer)
                mixed = np.zeros_like(tokens)
                for t in range(frames):
                    for row in range(rows):
                        places = [(v, row * columns + column) for v in range(views) for column in range(columns)]
                        sequence = np.stack(
                            [
                                tokens[t, v, token]
                                + self.two_layers(f"view_pos_embeds.{place}", sinusoid(v, width))
                                + cameras[t][v][min(token, len(cameras[t][v]) - 1)]
                                for v, token in places
                            ]
                        )
                        out = self.mixing(
                            f"crossview_transformer_blocks.{place}",
                            sequence,
                            lambda a, b, t=t: (
                                a // columns == b // columns
                                or (adjacent[a // columns, b // columns] and present[t, b // columns])
                            ),
                        )
                        for (v, token), value in zip(places, out):
                            mixed[t, v, token] = value
                share = 1.0 / (1.0 + np.exp(-state[f"view_mixers.{place}.mix_factor"]))
                tokens = share * tokens + (1.0 - share) * mixed
        out = np.zeros((frames, views, channels, height, length))
        for t in range(frames):
            for v in range(views):
                scale, shift = np.split(self.linear("norm_out.linear", silu(conditions[t, v])), 2)
                patches = self.linear("proj_out", normalise(tokens[t, v], 1e-6) * (1 + scale) + shift)
                for token, patch in enumerate(patches):
                    row, column = divmod(token, columns)
                    out[t, v, :, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2] = patch.reshape(
                        2, 2, channels
                    ).transpose(2, 0, 1)
        return out
