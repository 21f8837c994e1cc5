"""The small networks that are trained."""

from __future__ import annotations

from hybridworldsim.generation.autoencoder.tiny import TinySettings
from hybridworldsim.generation.network.configuration import AdapterConfig, TransformerConfig

T = 2
NETWORK = TransformerConfig(
    latent_channels=4, reference_channels=4 * T, latent_stride=4, layers=2, heads=2, head_channels=4, dual_layers=(),
    text_channels=3, pooled_channels=3, grid=8, grid_base=4, camera="explicit", origin_octaves=1, direction_octaves=2,
    temporal_layers=(), cross_view_layers=(0,), layout=AdapterConfig(4 * (T + 1), 8, scales=(1,)),
    background=AdapterConfig(3, 8, scales=(1,)),
)  # fmt: skip
CODEC = TinySettings(channels=4, width=8)
