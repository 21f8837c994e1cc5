"""A sliding cache of a rollout's references: an approximation that computes the keys and values of each frame once.

Exactly, all T references are computed again for each frame: their place in the window, their poses relative to its
first frame and the frames that they attend to change when the window slides. Here each keeps what it had when it was
the newest reference: places count on, poses stay relative to one frame, and what it attended to is not forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from hybridworldsim.generation.network.conditions import PreparedConditions, ReferenceCache
from hybridworldsim.generation.network.transformer import Transformer


class SlidingCache:
    """Keys and values of the references of one rollout.

    Args:
        refresh_every: all references are computed exactly at least once in as many frames; 1: for each frame.

    Attributes:
        encoded_frames: number of reference frames whose keys and values were computed so far.
    """

    def __init__(self, refresh_every: int) -> None:
        self._refresh_every = refresh_every
        self._origin: Tensor | None = None
        self._held: ReferenceCache | None = None
        self._frame, self._views, self._age = 0, [-1], 0
        self.encoded_frames = 0

    def begin(self, frame: int, views: Sequence[int], pose: Tensor) -> Tensor:
        """Begin a frame; cached references of another frame or of other views are dropped.

        Args:
            frame: number of the frame.
            views: views that are generated.
            pose: (B, 1, 4, 4) ``shared_SE3_ego`` of the window's first frame.

        Returns:
            (B, 1, 4, 4) the pose to which those of the window are relative.
        """
        continues = self._held is not None and frame == self._frame + 1 and list(views) == self._views
        self._age = self._age + 1 if continues else 0
        if self._age >= self._refresh_every:
            self._age = 0
        if self._age == 0:
            self._held, self._origin = None, pose
        self._frame, self._views = frame, list(views)
        return pose if self._origin is None else self._origin

    def encode(
        self, network: Transformer, references: Tensor, timestep: Tensor, prepared: PreparedConditions
    ) -> ReferenceCache:
        """Return the keys and values of the references of the frame that was begun.

        Args:
            network: a causal network.
            references: (B, T, V, C, H, W) latents.
            timestep: (B, T, V) their noise level, from 0 to 1000.
            prepared: conditions of the T references.
        """
        if self._held is None:
            self._held = network.encode_references(references, timestep, prepared)
            self.encoded_frames += references.shape[1]
        else:
            newest = slice(references.shape[1] - 1, references.shape[1])
            earlier = self._held.without_oldest()
            own = network.encode_references(
                references[:, newest], timestep[:, newest], prepared.frames(newest), earlier
            )
            self._held = earlier.followed_by(own)
            self.encoded_frames += 1
        return self._held
