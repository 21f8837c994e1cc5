"""The configuration of the transformer, and those of the released models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from mirror.errors import UsageError

CAMERA_NUMBERS: Final = 11
"""Numbers of the implicit camera condition: rate, four intrinsics, forward axis (3) and position (3) of the camera."""


@dataclass(frozen=True)
class AdapterConfig:
    """The configuration of an adapter, which turns images into features that are added to the tokens.

    They are added before the first transformer layers.

    Attributes:
        channels: channels of the images.
        width: channels within the adapter.
        unshuffle: side of the blocks of pixels that become one pixel with more channels.
        scales: for each block, the side of its cells in tokens: 1 is the token grid, 2 half its resolution. The block's
            feature is interpolated to the token grid and added before the transformer layer of the same index.
        resnets: residual units in each block.
    """

    channels: int
    width: int
    unshuffle: int = 8
    scales: tuple[int, ...] = (1, 1, 1, 1, 1, 1)
    resnets: int = 2

    def __post_init__(self) -> None:
        pairs = zip((1, *self.scales), self.scales)
        if not self.scales or any(before > scale or scale % before for before, scale in pairs):
            raise UsageError(f"scales {self.scales} of an adapter", expected="each a multiple of the one before it")


@dataclass(frozen=True)
class TransformerConfig:
    """The configuration of a transformer, by default as OpenDWM's CTSD on Stable Diffusion 3.5 medium.

    Attributes:
        latent_channels: channels of the latents that the network denoises.
        reference_channels: further channels of the input, which hold the latents of reference frames; 0 if references
            are frames of the sequence.
        latent_stride: pixels per latent, along a side.
        patch: latents per token, along a side.
        layers: number of joint blocks.
        heads: attention heads.
        head_channels: channels of each head.
        dual_layers: joint blocks with a second attention, among the tokens of the image only.
        joint_norm: whether joint attention normalises queries and keys.
        mixing_norm: whether temporal and cross-view attention do.
        text_channels: channels of a text token.
        pooled_channels: channels of the pooled text.
        grid: side of the table of positions, in tokens.
        grid_base: side of the grid of the base model's training, in tokens; scales the positions.
        camera: how the pose and the lens of cameras enter: ``implicit`` as numbers per image, ``explicit`` as a ray per
            token, or not at all.
        origin_octaves: octaves of the encoded origin of a ray.
        direction_octaves: octaves of its encoded direction.
        temporal_layers: joint blocks that a temporal block follows.
        temporal_attention: ``pointwise``: among the frames at each token. ``full``: among all tokens of all frames.
        causal: whether frames attend only to themselves and to earlier ones. Released weights are not causal.
        cross_view_layers: joint blocks that a cross-view block follows.
        layout: the adapter of the layout images, or None. Its channels are those of boxes, or these and three of a map,
            for each of `layout_frames`.
        background: the adapter of the background images, or None. Released weights have none.
    """

    latent_channels: int = 16
    reference_channels: int = 0
    latent_stride: int = 8
    patch: int = 2
    layers: int = 24
    heads: int = 24
    head_channels: int = 64
    dual_layers: tuple[int, ...] = tuple(range(13))
    joint_norm: bool = True
    mixing_norm: bool = True
    text_channels: int = 4096
    pooled_channels: int = 2048
    grid: int = 384
    grid_base: int = 64
    camera: Literal["implicit", "explicit", "none"] = "implicit"
    origin_octaves: int = 8
    direction_octaves: int = 4
    temporal_layers: tuple[int, ...] = (2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23)
    temporal_attention: Literal["pointwise", "full"] = "pointwise"
    causal: bool = False
    cross_view_layers: tuple[int, ...] = (1, 5, 9, 13, 17, 21)
    layout: AdapterConfig | None = AdapterConfig(6, 1536)
    background: AdapterConfig | None = None

    def __post_init__(self) -> None:
        for name in ("dual_layers", "temporal_layers", "cross_view_layers"):
            layers = getattr(self, name)
            if list(layers) != sorted(set(layers)) or any(not 0 <= layer < self.layers for layer in layers):
                raise UsageError(f"{name} {layers}", expected=f"ascending numbers below {self.layers}")
        for name in ("layout", "background"):
            adapter = getattr(self, name)
            if adapter is not None and len(adapter.scales) > self.layers:
                raise UsageError(f"{len(adapter.scales)} features of {name}", expected=f"at most {self.layers}")
            if adapter is not None and self.token_px % adapter.unshuffle:
                raise UsageError(f"{name} joins {adapter.unshuffle} pixels", expected=f"a divisor of {self.token_px}")

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> TransformerConfig:
        """Make a configuration from its fields as JSON values, as `dataclasses.asdict` gives them.

        Raises:
            UsageError: a field is unknown, or a value is not allowed.
        """
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in document.items()
        }
        try:
            for name in ("layout", "background"):
                adapter = values.get(name)
                if adapter is not None:
                    values[name] = AdapterConfig(**{**adapter, "scales": tuple(adapter["scales"])})
            return cls(**values)
        except (TypeError, KeyError) as error:
            raise UsageError(
                f"a configuration that does not fit ({error})", expected="that of a transformer"
            ) from error

    @property
    def width(self) -> int:
        """Channels of a token."""
        return self.heads * self.head_channels

    @property
    def token_px(self) -> int:
        """Pixels per token, along a side."""
        return self.latent_stride * self.patch

    @property
    def layout_frames(self) -> int:
        """Number of frames whose layouts one input holds as channels: the target, and the T references if set so."""
        return 1 + self.reference_channels // self.latent_channels

    def takes_size(self, size_px: tuple[int, int]) -> bool:
        """Return whether images of this height and width are whole tokens, within the table of positions."""
        return all(0 < side <= self.grid * self.token_px and side % self.token_px == 0 for side in size_px)

    @property
    def sizes(self) -> str:
        """The sizes for which `takes_size` holds, in words."""
        return f"multiples of {self.token_px} px along both sides, at most {self.grid * self.token_px} px"


CTSD_35: Final = TransformerConfig()
"""OpenDWM's layout-conditioned model on Stable Diffusion 3.5 medium (``ctsd_35_tirda_bm_nwao``)."""

UNIMLVG: Final = TransformerConfig(
    dual_layers=(),
    joint_norm=False,
    mixing_norm=False,
    grid=192,
    camera="explicit",
    temporal_layers=(1, 5, 9, 13, 17, 21),
    temporal_attention="full",
)
"""OpenDWM's UniMLVG, stage 3, on Stable Diffusion 3 medium (``ctsd_unimlvg_tirda_bm_nwa``)."""

BACKGROUND: Final = AdapterConfig(3, 384, scales=(1, 1, 2, 2, 4, 4))
"""The background adapter that is added to a released model."""

TINY_REFERENCES: Final = 5

TINY: Final = TransformerConfig(
    latent_channels=8,
    reference_channels=8 * TINY_REFERENCES,
    latent_stride=4,
    layers=5,
    heads=4,
    head_channels=36,
    dual_layers=(),
    text_channels=8,
    pooled_channels=8,
    grid=32,
    grid_base=8,
    camera="explicit",
    origin_octaves=1,
    direction_octaves=3,
    temporal_layers=(),
    cross_view_layers=(1, 3),
    layout=AdapterConfig(4 * (TINY_REFERENCES + 1), 96, scales=(1, 1, 1)),
    background=AdapterConfig(3, 96, scales=(1, 1, 2)),
)
"""A network of a few million parameters for images of a hundred pixels, trained on one core: references as channels."""

SMALL: Final = replace(
    TINY,
    layers=8,
    heads=6,
    head_channels=64,
    grid=64,
    grid_base=32,
    cross_view_layers=(1, 4, 7),
    layout=AdapterConfig(4 * (TINY_REFERENCES + 1), 192, scales=(1, 1, 1)),
    background=AdapterConfig(3, 192, scales=(1, 1, 2)),
)
"""A network of 63 million parameters for images of 448 x 256, trained on a GPU; its parts are those of `TINY`."""

SIZES: Final = {"tiny": TINY, "small": SMALL}
"""The networks that `mirror generate train` trains, by name."""

BASES: Final = {"ctsd-35": CTSD_35, "unimlvg": UNIMLVG}
"""Released models that can be loaded, by name."""
