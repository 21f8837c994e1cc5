"""The rig adjustment on exact and noisy tracks: injected errors, a dense solver, finite differences, closed forms."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mirror.calibration.estimate import FARTHEST_M
from mirror.calibration.refinement.adjustment import Adjuster, RigState, adjust_rigs
from mirror.calibration.refinement.features import ImageFeatures, find_features, match_features
from mirror.calibration.refinement.matching import MatchingOptions, choose_pairs, join_tracks
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs, RefinementPrior
from mirror.calibration.refinement.scene import SceneRigs
from mirror.calibration.refinement.summary import summarise
from mirror.calibration.refinement.triangulation import triangulate
from mirror.calibration.rig import PosePrior
from mirror.calibration.tracking import TrackedImage
from mirror.dataset.traversal import CameraCalibration
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from tests.calibration.exact_rig import CAMERAS
from tests.calibration.moving_rigs import moving_rigs, true_mountings

ERRORS = np.array([[0.3, -0.5, 0.4], [-0.6, 0.2, 0.1], [0.0, 0.05, -0.9]])


def relative_angles_deg(found: Poses) -> np.ndarray:
    """Angles (K,) between rotations relative to the first camera and the true ones."""
    from scipy.spatial.transform import Rotation

    relative = [np.einsum("ji,kjl->kil", m[0], m) for m in (matrix_from_quaternion(p.rotation) for p in
                                                            (found, true_mountings()))]  # fmt: skip
    return np.degrees(Rotation.from_matrix(np.swapaxes(relative[1], 1, 2) @ relative[0]).magnitude())


def true_state(rigs: MovingRigs, tracks: FeatureTracks) -> RigState:
    points, _ = triangulate(replace(rigs, ego_SE3_camera=true_mountings()), tracks)
    frames, count = len(rigs.time_s), len(rigs.cameras)
    return RigState(
        np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3)), matrix_from_quaternion(true_mountings().rotation),
        true_mountings().translation.copy(), *np.zeros((2, count, 3)), points,
    )  # fmt: skip


def test_exact_tracks_give_the_true_mountings() -> None:
    rigs, tracks = moving_rigs(70.0, errors_deg=ERRORS)
    found = adjust_rigs(rigs, tracks)
    assert relative_angles_deg(rigs.ego_SE3_camera).max() > 0.8
    assert relative_angles_deg(found.ego_SE3_camera).max() < 2e-3
    assert found.residual_px.max() < 0.02
    assert found.converged
    lens = np.abs([camera.cx_px - given.cx_px for camera, given in zip(found.cameras, rigs.cameras)])
    assert lens.max() < 0.02


def test_a_huge_offset_of_the_world_changes_nothing() -> None:
    near = adjust_rigs(*moving_rigs(70.0, errors_deg=ERRORS))
    far = adjust_rigs(*moving_rigs(70.0, errors_deg=ERRORS, offset=(4e6, -3e6, 100.0)))
    turns = [matrix_from_quaternion(one.ego_SE3_camera.rotation) for one in (near, far)]
    assert np.degrees(np.abs(turns[0] - turns[1]).max()) < 1e-3


def test_derivatives_are_those_of_the_residuals() -> None:
    rigs, tracks = moving_rigs(70.0, frames=3, points=60, errors_deg=ERRORS, noise_px=0.5)
    # A huge scale of the loss makes the cost quadratic: its gradient is that of the sum of squares.
    adjuster = Adjuster(rigs, RefinementPrior(feature_px=1e3))
    points, kept = triangulate(rigs, tracks)
    state = replace(true_state(rigs, tracks), points=points)
    assert kept.any()
    tracks_used = np.isfinite(points).all(axis=1)
    assert tracks_used.all()
    rng = np.random.default_rng(8)
    state = state.moved(0.01 * rng.normal(size=6 * 3 + 9 * 3), 0.1 * rng.normal(size=points.shape))
    sigma = adjuster._sigma_px(tracks)
    # Without elimination the gradient of frames and mountings would be the sum below; with points held it is exact.
    _, _, reduced, _, inverses, mixed, slopes = adjuster._equations(state, tracks, sigma, 0.0)
    size = len(reduced)
    direct = reduced.copy()
    for row in range(len(tracks.image)):
        t, number = tracks.track[row], tracks.image[row]
        columns = [*(6 * rigs.frame[number] + np.arange(6)), *(18 + 9 * rigs.mounting[number] + np.arange(9))]
        direct[columns] += mixed[row] @ inverses[t] @ slopes[t]

    def cost(step: np.ndarray, moves: np.ndarray) -> float:
        square = (adjuster.residuals(state.moved(step, moves), tracks) ** 2).sum(axis=1) / sigma**2
        return 0.5 * float(np.log1p(square).sum())

    for column in range(size):
        step = np.zeros(size)
        step[column] = 1e-5
        difference = (cost(step, 0 * points) - cost(-step, 0 * points)) / 2e-5
        assert direct[column] == pytest.approx(difference, rel=1e-4, abs=1e-7 * np.abs(direct).max())
    for point, axis in [(0, 0), (5, 1), (9, 2)]:
        move = np.zeros_like(points)
        move[point, axis] = 1e-4
        difference = (cost(np.zeros(size), move) - cost(np.zeros(size), -move)) / 2e-4
        assert slopes[point, axis] == pytest.approx(difference, rel=1e-4, abs=1e-9)


def test_the_eliminated_points_give_the_step_of_the_whole_system() -> None:
    rigs, tracks = moving_rigs(70.0, frames=3, points=25, errors_deg=0.2 * ERRORS)
    adjuster = Adjuster(rigs, RefinementPrior(feature_px=1e3))
    state = replace(true_state(rigs, tracks), points=triangulate(rigs, tracks)[0] + 0.05)
    sigma = adjuster._sigma_px(tracks)

    def residuals(values: np.ndarray) -> np.ndarray:
        split = 6 * 3 + 9 * 3
        moved = state.moved(values[:split], values[split:].reshape(-1, 3))
        return (adjuster.residuals(moved, tracks) / sigma[:, None]).ravel()

    size = 6 * 3 + 9 * 3 + state.points.size
    whole = np.stack([(residuals(h) - residuals(-h)) / 2e-6 for h in 1e-6 * np.eye(size)], axis=1)
    prior = np.zeros((size, size))
    count = len(adjuster.information)
    prior[:count, :count] = adjuster.information
    matrix, right = whole.T @ whole + prior, whole.T @ residuals(np.zeros(size))
    right[:count] += adjuster.information @ adjuster.deviation(state)
    expected = -np.linalg.solve(matrix, right)[:count]
    reduced, _, gradient, *_ = adjuster._equations(state, tracks, sigma, 0.0)
    step = -np.linalg.solve(reduced + adjuster.information, gradient + adjuster.information @ adjuster.deviation(state))
    assert np.abs(step - expected).max() < 1e-4 * np.abs(expected).max()


def test_intervals_cover_and_do_not_exaggerate() -> None:
    # The recorded values are exact here, and stated so: what is left is the noise of the features.
    prior = RefinementPrior(PosePrior(1e-5, 1e-5, 1e-5, 4.0, 1e-5), focal_share=1e-8, centre_share=1e-8)
    inside, sizes = [], []
    for seed in range(6):
        rigs, tracks = moving_rigs(70.0, errors_deg=ERRORS, noise_px=0.25, seed=seed, points=250)
        found = adjust_rigs(rigs, tracks, prior)
        true = matrix_from_quaternion(true_mountings().rotation)
        turns = matrix_from_quaternion(found.ego_SE3_camera.rotation)
        for number in range(len(CAMERAS)):
            off = Poses.from_matrix(np.block([[true[number].T @ turns[number], np.zeros((3, 1))],
                                              [np.zeros((1, 3)), np.ones((1, 1))]])[None]).log()[0, :3]  # fmt: skip
            sigma = np.sqrt(np.diag(found.covariance)[found.mounting_columns(number)][:3])
            inside += (np.abs(off) < 1.96 * sigma).tolist()
            sizes += (np.abs(off) / sigma).tolist()
    assert 0.85 <= np.mean(inside) <= 1.0
    assert np.sqrt(np.mean(np.square(sizes))) > 0.6


@pytest.mark.parametrize(
    ("turn_deg", "step_m", "status"),
    [(0.0, 0.02, ("kept", "kept", "kept")), (70.0, 2.0, ("refined", "kept", "kept"))],
)
def test_a_reference_camera_of_which_nothing_is_observable_keeps_its_calibration(
    turn_deg: float, step_m: float, status: tuple[str, ...]
) -> None:
    """The reference camera alone has features: a median of its own recorded rotation would be no estimate."""
    rigs, tracks = moving_rigs(turn_deg, step_m=step_m, errors_deg=ERRORS, noise_px=0.1)
    own = rigs.mounting[tracks.image] == 0
    track = np.unique(tracks.track[own], return_inverse=True)[1].astype(np.int64)
    often = np.bincount(track)[track] >= 2
    track = np.unique(track[often], return_inverse=True)[1].astype(np.int64)
    seen = FeatureTracks(track, *(part[own][often] for part in (tracks.image, tracks.uv_px, tracks.scale_px)))
    calibrations = [
        CameraCalibration(name, "factory", None, None, camera, rigs.ego_SE3_camera[np.array([number])], {})
        for number, (name, camera) in enumerate(CAMERAS.items())
    ]
    scene = SceneRigs(rigs, calibrations, ["d"] * 3, [])
    found = summarise(adjust_rigs(rigs, seen), scene, ["ahead"] * 3)
    assert tuple(one.status for one in found) == status
    assert len(found[0].held) == (3 if status[0] == "kept" else 0)
    assert ("no axis of its rotation" in (found[0].reason or "")) == (status[0] == "kept")


def test_wrong_observations_have_little_influence() -> None:
    rigs, tracks = moving_rigs(70.0, errors_deg=ERRORS, noise_px=0.1)
    rng = np.random.default_rng(4)
    wrong = rng.random(len(tracks.image)) < 0.1
    uv = tracks.uv_px + wrong[:, None] * rng.normal(0.0, 20.0, tracks.uv_px.shape)
    assert relative_angles_deg(adjust_rigs(rigs, replace(tracks, uv_px=uv)).ego_SE3_camera).max() < 0.02


def test_moving_clouds_are_left_out() -> None:
    rigs, tracks = moving_rigs(70.0, errors_deg=ERRORS)
    # Features at infinity whose direction drifts by 0.1 degrees a frame.
    poses, rows = rigs.world_SE3_cameras(), []
    for cloud in range(150):
        azimuth, height = 2.0 * np.pi * cloud / 150, 0.25
        for image in range(len(rigs.frame)):
            turned = azimuth + np.radians(0.1) * rigs.frame[image]
            way = np.array([np.cos(turned), np.sin(turned), height])
            ray = matrix_from_quaternion(poses[image : image + 1].rotation)[0].T @ way
            seen = rigs.cameras[rigs.mounting[image]].project(ray[None])
            # The mountings of the rig are wrong, those of the images true: the error matters little here.
            if seen.valid[0]:
                rows.append((len(tracks) + cloud, image, *seen.uv_px[0]))
    table = np.array(rows)
    merged = FeatureTracks(
        np.concatenate([tracks.track, np.unique(table[:, 0], return_inverse=True)[1] + len(tracks)]),
        np.concatenate([tracks.image, table[:, 1].astype(np.int64)]),
        np.concatenate([tracks.uv_px, table[:, 2:]]),
        np.concatenate([tracks.scale_px, np.ones(len(table))]),
    )
    found = adjust_rigs(rigs, merged)
    assert relative_angles_deg(found.ego_SE3_camera).max() < 0.01
    assert np.linalg.norm(found.state.points - rigs.world_SE3_ego.translation[0], axis=1).max() < FARTHEST_M + 50.0


def test_triangulated_points_are_those_of_the_rays() -> None:
    rigs, tracks = moving_rigs(70.0)
    points, usable = triangulate(rigs, tracks)
    for track in (0, 7, 30):
        own = tracks.track == track
        poses = rigs.world_SE3_cameras()[tracks.image[own]]
        seen = [
            rigs.cameras[rigs.mounting[image]].project(poses[k : k + 1].inverse().transform(points[track][None])[0])
            for k, image in enumerate(tracks.image[own])
        ]
        assert np.abs(np.concatenate([one.uv_px for one in seen]) - tracks.uv_px[own]).max() < 1e-6
    assert usable.mean() > 0.9


@pytest.mark.parametrize("frames", [1, 4])
def test_without_motion_nothing_can_be_adjusted(frames: int) -> None:
    rigs, tracks = moving_rigs(0.0, frames=frames, step_m=0.0, points=80)
    one = rigs.mounting[tracks.image] == 0
    count = np.bincount(tracks.track[one], minlength=len(tracks))
    one &= count[tracks.track] >= 1
    track = np.unique(tracks.track[one], return_inverse=True)[1].astype(np.int64)
    alone = FeatureTracks(track, tracks.image[one], tracks.uv_px[one], tracks.scale_px[one])
    with pytest.raises(UsageError, match="seen from two places"):
        adjust_rigs(rigs, alone)


def test_no_tracks_are_refused() -> None:
    rigs, _ = moving_rigs(70.0, frames=2)
    empty = FeatureTracks(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0))
    with pytest.raises(UsageError, match="no feature"):
        adjust_rigs(rigs, empty)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_priors_are_positive(value: float) -> None:
    with pytest.raises(UsageError, match="above 0"):
        RefinementPrior(centre_share=value)
    with pytest.raises(UsageError, match="above 0"):
        RefinementPrior(PosePrior(mounting_m=value))


def textured(seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    smooth = sum(
        scale * cv2.GaussianBlur(rng.normal(size=(240, 320)).astype(np.float32), (0, 0), scale) for scale in (1.5, 3, 6)
    )
    return np.clip(128.0 + 40.0 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def test_features_of_a_mirrored_image_are_mirrored() -> None:
    grey = textured()
    ones = find_features(TrackedImage.from_grey(grey), 500)
    others = find_features(TrackedImage.from_grey(np.ascontiguousarray(grey[::-1, ::-1])), 500)
    back = np.array([320.0, 240.0]) - others.uv_px
    apart = ones.uv_px[:, None] - back[None]
    nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
    off = apart[np.arange(len(ones)), nearest]
    near = np.linalg.norm(off, axis=1) < 1.0
    assert near.mean() > 0.8
    # An error of convention by half a pixel would make this one pixel, one of the enlargement a half.
    assert np.abs(np.median(off[near], axis=0)).max() < 0.02


def test_masked_and_flat_images_have_no_features() -> None:
    still = np.zeros((240, 320), bool)
    still[:, 160:] = True
    found = find_features(TrackedImage.from_grey(textured(), still), 500)
    assert len(found) > 20
    assert found.uv_px[:, 0].min() > 159.0
    flat = find_features(TrackedImage.from_grey(np.full((60, 80), 90, np.uint8)), 500)
    assert len(flat) == 0
    assert match_features(flat, found).shape == (0, 2)


def test_matches_are_mutual_and_clear() -> None:
    rng = np.random.default_rng(2)
    one = rng.integers(0, 255, (40, 128)).astype(np.uint8)
    order = rng.permutation(40)
    first = ImageFeatures(np.zeros((40, 2)), np.ones(40), one)
    second = ImageFeatures(np.zeros((40, 2)), np.ones(40), one[order])
    pairs = match_features(first, second)
    assert len(pairs) == 40
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()
    twice = ImageFeatures(np.zeros((80, 2)), np.ones(80), np.concatenate([one, one]))
    assert not len(match_features(first, twice))


def test_tracks_lose_images_with_two_features() -> None:
    features = [ImageFeatures(np.full((3, 2), float(k)), np.ones(3), np.zeros((3, 128), np.uint8)) for k in range(3)]
    matches = {
        (0, 1): np.array([[0, 0], [1, 1]]),
        (1, 2): np.array([[0, 0], [1, 1]]),
        # Feature 2 of image 2 is joined to the first track, which has feature 0 of that image already.
        (0, 2): np.array([[0, 2]]),
    }
    tracks = join_tracks(features, matches)
    assert len(tracks) == 2
    assert [tracks.image[tracks.track == t].tolist() for t in range(2)] == [[0, 1], [0, 1, 2]]
    assert len(join_tracks([], {})) == 0


def test_overlapping_images_are_paired() -> None:
    rigs, _ = moving_rigs(0.0, frames=4)
    pairs = choose_pairs(rigs, MatchingOptions(own=2, others=2))
    names = list(CAMERAS)
    kinds = {tuple(sorted((names[rigs.mounting[a]], names[rigs.mounting[b]]))) for a, b in pairs.tolist()}
    assert ("ahead", "ahead") in kinds
    assert ("ahead", "left") in kinds
    assert ("left", "right") not in kinds
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)
