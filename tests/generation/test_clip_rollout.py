"""Rollouts over clips: what is kept, what is blended, and edits of boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import CATEGORIES
from hybridworldsim.generation.clips.edits import add_track, move_track, remove_track
from hybridworldsim.generation.inference.blending import blend, hull_shares
from hybridworldsim.generation.inference.clip_rollout import (
    ClipRolloutOptions,
    clip_hulls,
    roll_out_clip,
    views_with_boxes,
)
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.inference.windows import join_conditions
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.sampling.sampler import draw_noise
from mirror.errors import UsageError
from tests.generation.builders import make_network
from tests.generation.clips import FRAMES, HEIGHT, WIDTH, make_clip
from tests.generation.rollout_inputs import AS_CHANNELS, AS_FRAMES, seeds, single_frames
from tests.generation.rollout_inputs import T as REFERENCES
from tests.generation.trained import CODEC, NETWORK, T

OPTIONS = ClipRolloutOptions(SamplerSettings(steps=2))


def roll(clip, options=OPTIONS, network=None, **kwargs):
    torch.manual_seed(0)
    network = network or make_network(NETWORK).float()
    return list(roll_out_clip(network, TinyAutoencoder(CODEC), clip, OWN_STYLE, 3, T, options, **kwargs))


def test_frames_are_generated_from_the_first_one_on() -> None:
    clip = make_clip()
    frames = roll(clip)
    assert [one.frame for one in frames] == list(range(3, FRAMES))
    assert all(one.generated.all() for one in frames)
    again = roll(clip)
    assert all(np.array_equal(one.images, other.images) for one, other in zip(frames, again))
    # Recorded images from the first generated frame on are not read; the seeds are.
    later = clip.images.copy()
    later[3:] = 0
    assert all(
        np.array_equal(one.images, other.images) for one, other in zip(frames, roll(replace(clip, images=later)))
    )
    seeds_changed = clip.images.copy()
    seeds_changed[2] = 0
    assert not np.array_equal(frames[0].images, roll(replace(clip, images=seeds_changed))[0].images)


def test_views_without_a_box_keep_their_background_to_the_bit() -> None:
    clip = make_clip()
    mounts = clip.ego_SE3_camera.copy()
    # The second camera looks backwards, where no box is.
    mounts[1, :3, :3] = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    clip = replace(clip, ego_SE3_camera=mounts)
    assert views_with_boxes(clip, 4).tolist() == [True, False]
    for frame in roll(clip):
        assert frame.generated.tolist() == [True, False]
        assert np.array_equal(frame.images[1], clip.background[frame.frame, 1])
        assert not np.array_equal(frame.images[0], clip.background[frame.frame, 0])
    everywhere = roll(clip, replace(OPTIONS, keep_empty_views=False))
    assert all(frame.generated.all() for frame in everywhere)


def test_frames_without_boxes_cost_nothing() -> None:
    network, ran = make_network(NETWORK).float(), []
    for part in network.modules():
        part.register_forward_pre_hook(lambda *_: ran.append(1))
    roll(make_clip(), network=network)
    assert ran
    ran.clear()
    clip = remove_track(make_clip(), 3)
    for frame in roll(clip, network=network):
        assert np.array_equal(frame.images, clip.background[frame.frame])
        assert not frame.generated.any()
    assert not ran


def test_an_absent_view_is_not_generated() -> None:
    clip = make_clip()
    present = clip.present.copy()
    present[:, 0] = False
    assert all(frame.generated.tolist() == [False, True] for frame in roll(replace(clip, present=present)))


@pytest.mark.parametrize("config", [AS_CHANNELS, AS_FRAMES], ids=["channels", "frames"])
def test_views_that_are_not_generated_are_given_and_counted(config) -> None:
    network, frames = make_network(config), single_frames(REFERENCES + 2)
    kept = torch.randn((1, 1, 2, 4, 4, 6), dtype=torch.float64)
    rollout = SequenceRollout(network, seeds(), frames[:REFERENCES], SamplerSettings(steps=1))
    first = rollout.step(frames[REFERENCES], active=[1], kept=kept)
    assert torch.equal(first[:, :, 0], kept[:, :, 0])
    # As a rig of the second camera alone, with its number in the rig and its part of the noise.
    window = join_conditions(config, frames[: REFERENCES + 1]).views([1])
    noise = draw_noise(kept.shape, (0, 0)).double()[:, :, [1]]
    alone = sample_frame(network, seeds()[:, :, [1]], window, noise, SamplerSettings(steps=1))
    torch.testing.assert_close(first[:, :, [1]], alone, rtol=1e-9, atol=1e-9)
    second = rollout.step(frames[REFERENCES + 1], active=[], kept=kept)
    assert torch.equal(second, kept)
    assert (rollout.generated_views, rollout.kept_views) == (1, 3)
    with pytest.raises(UsageError, match="no latents of the views"):
        rollout.step(frames[REFERENCES + 1], active=[0])


def test_hulls_do_not_shrink() -> None:
    with pytest.raises(UsageError, match="grown by -1 px"):
        ClipRolloutOptions(blend_px=-1)


def test_blended_images_are_the_background_away_from_boxes() -> None:
    clip = make_clip()
    for frame, plain in zip(roll(clip, replace(OPTIONS, blend_px=1)), roll(clip)):
        shares = hull_shares(clip_hulls(clip, frame.frame), 1)
        assert np.array_equal(frame.images[shares == 0.0], clip.background[frame.frame][shares == 0.0])
        assert np.array_equal(frame.images[shares == 1.0], plain.images[shares == 1.0])
        assert (shares == 1.0).any()
        assert (shares == 0.0).any()
    half = blend(
        np.full((1, 1, 1, 3), 200, np.uint8), np.zeros((1, 1, 1, 3), np.uint8), np.full((1, 1, 1), 0.5, np.float32)
    )
    assert half.ravel().tolist() == [100, 100, 100]


def test_edits_hold_for_generated_frames_and_not_for_seeds() -> None:
    clip = make_clip()
    moved = move_track(clip, 3, dy=1.5)
    plain, edited = roll(clip), roll(clip, edited=moved)
    assert not np.array_equal(plain[0].images, edited[0].images)
    only_seeds = replace(
        clip.boxes,
        ego_SE3_box=np.where((clip.boxes.frame < 3)[:, None, None], moved.boxes.ego_SE3_box, clip.boxes.ego_SE3_box),
    )
    other = roll(clip, edited=replace(clip, boxes=only_seeds))
    assert all(np.array_equal(one.images, two.images) for one, two in zip(plain, other))


def test_a_move_is_along_the_axes_of_the_box() -> None:
    clip = make_clip()
    turned = clip.boxes.ego_SE3_box.copy()
    # A quarter turn to the left: the box's left is the vehicle's rear.
    turned[:, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    clip = replace(clip, boxes=replace(clip.boxes, ego_SE3_box=turned))
    moved = move_track(clip, 3, dx=0.5, dy=2.0).boxes.ego_SE3_box[:, :3, 3] - turned[:, :3, 3]
    np.testing.assert_allclose(moved, np.tile((-2.0, 0.5, 0.0), (FRAMES, 1)))


def test_an_added_road_user_stands_in_the_street() -> None:
    clip = make_clip()
    place = np.eye(4)
    place[:3, 3] = 12.0, 2.0, 0.9
    added = add_track(clip, "pedestrian", place, np.array([0.6, 0.6, 1.8]))
    new = added.boxes[added.boxes.track == 4]
    assert new.category.tolist() == [CATEGORIES.index("pedestrian")] * FRAMES
    # The vehicle drives a metre per frame towards it.
    np.testing.assert_allclose(new.ego_SE3_box[:, 0, 3], 12.0 - np.arange(FRAMES))
    assert len(remove_track(added, 4).boxes) == len(clip.boxes)
    with pytest.raises(UsageError, match="a road user 'tram'"):
        add_track(clip, "tram", place, np.ones(3))
    with pytest.raises(UsageError, match="no box of track 9"):
        move_track(clip, 9, dy=1.0)
    assert clip.size_px == (HEIGHT, WIDTH)
