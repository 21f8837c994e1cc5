"""Tests that measurement errors have the requested size, and vanish where none are requested."""

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry import Poses, angle_between_deg
from mirror.geometry.cameras import Camera
from mirror.synth.errors import MAX_SIGMA, Errors, MountingError, draw_drift


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def track(count: int = 400) -> tuple[Poses, np.ndarray]:
    time_s = np.arange(count) * 0.05
    twist = np.zeros((count, 6))
    twist[:, 2] = 0.3 * np.sin(time_s)
    return Poses(Poses.exp(twist).rotation, np.stack([300.0 + 8 * time_s, -150 + 2 * time_s, 0 * time_s], 1)), time_s


def test_errors_none_changes_nothing() -> None:
    truth, time_s = track()
    errors = Errors.none()
    measured = errors.perturb_poses(truth, time_s, rng())
    assert np.array_equal(measured.translation, truth.translation)
    assert angle_between_deg(measured.rotation, truth.rotation).max() < 1e-6
    camera = Camera("brown_conrady", 200, 100, 150.0, 150.0, 99.0, 51.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
    assert errors.perturb_camera(camera, rng()) == camera
    assert all((one.offset_ns, one.error_ns) == (0, 0) for one in errors.draw_clocks("ab", rng()).values())
    assert not errors.draw_losses(1000, rng()).any()
    assert errors.sigma_m == 0.0
    assert errors.factory.draw(rng()).translation.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("step_s", [0.01, 0.05, 1.0, 20.0])
def test_drift_has_the_stated_variance_and_autocorrelation_at_any_step(step_s: float) -> None:
    over_s, count = 4.0, 40
    many = np.stack([draw_drift(np.arange(count) * step_s, over_s, rng(seed)) for seed in range(1500)]).transpose(
        1, 0, 2
    )
    values = many.reshape(count, -1)
    assert values.var(axis=1) == pytest.approx(1.0, abs=0.09)
    for lag in (1, 10, 39):
        t = lag * step_s / over_s
        assert np.mean(values[lag] * values[0]) == pytest.approx((1 + t) * np.exp(-t), abs=0.06)


def test_drift_is_smooth() -> None:
    values = draw_drift(np.arange(4000) * 0.05, 4.0, rng())
    assert np.abs(np.diff(values, axis=0)).max() < 0.05 / 4.0 * 5.0
    assert np.abs(np.diff(values, 2, axis=0)).max() < 0.02


def test_drift_accepts_uneven_repeated_single_and_no_times() -> None:
    assert draw_drift(np.zeros(0), 1.0, rng()).shape == (0, 3)
    assert draw_drift(np.array([7.0]), 1.0, rng()).shape == (1, 3)
    values = draw_drift(np.array([0.0, 0.1, 0.1, 5e5]), 1.0, rng())
    assert np.isfinite(values).all()
    assert np.array_equal(values[1], values[2])


def test_pose_errors_have_the_stated_size() -> None:
    truth, time_s = track()
    only = {"position_noise_m": 0.0, "position_drift_m": 0.0, "position_bias_m": 0.0, "attitude_noise_deg": 0.0}
    noise = Errors(**{**only, "position_noise_m": 0.05}).perturb_poses(truth, time_s, rng())
    assert (noise.translation - truth.translation).std() == pytest.approx(0.05, rel=0.1)
    bias = Errors(**{**only, "position_bias_m": 0.5}).perturb_poses(truth, time_s, rng())
    off = bias.translation - truth.translation
    assert np.ptp(off, axis=0).max() < 1e-12
    assert 0.05 < np.linalg.norm(off[0]) < 2.0
    turned = Errors(**{**only, "attitude_noise_deg": 0.3}).perturb_poses(truth, time_s, rng())
    assert np.array_equal(turned.translation, truth.translation)
    # The mean length of a vector of three normal errors is 2 sqrt(2 / pi) sigma.
    mean = angle_between_deg(turned.rotation, truth.rotation).mean()
    assert mean == pytest.approx(0.3 * 2 * np.sqrt(2 / np.pi), rel=0.1)


def test_the_same_seed_gives_the_same_errors() -> None:
    truth, time_s = track()
    first, again, other = (Errors().perturb_poses(truth, time_s, rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.translation, again.translation)
    assert np.array_equal(first.rotation, again.rotation)
    assert not np.array_equal(first.translation, other.translation)


def test_mounting_errors_are_bounded_and_have_the_stated_covariance() -> None:
    error, source = MountingError(0.5, 0.02), rng()
    twists = np.concatenate([error.draw(source).log() for _ in range(4000)])
    angles = np.degrees(np.linalg.norm(twists[:, :3], axis=1))
    assert MAX_SIGMA * 0.5 * 0.9 < angles.max() <= MAX_SIGMA * 0.5 + 1e-12
    covariance = np.array(error.covariance()).reshape(6, 6)
    # Truncation of the farthest 3 % reduces the spread a little.
    assert np.cov(twists.T).diagonal() == pytest.approx(covariance.diagonal(), rel=0.15)
    assert np.abs(np.corrcoef(twists.T) - np.eye(6)).max() < 0.06


def test_clocks_lenses_and_lost_images_have_the_stated_spread() -> None:
    errors = Errors(clock_offset_ns=2_000_000, clock_error_ns=50_000, focal_share=1e-3, centre_share=2e-3, dropped=0.1)
    names = [f"c{number}" for number in range(3000)]
    clocks = list(errors.draw_clocks(names, rng()).values())
    assert np.std([one.offset_ns for one in clocks]) == pytest.approx(2e6, rel=0.05)
    assert np.std([one.error_ns for one in clocks]) == pytest.approx(5e4, rel=0.05)
    assert errors.draw_losses(20000, rng()).mean() == pytest.approx(0.1, rel=0.1)
    camera, source = Camera("pinhole", 1000, 500, 700.0, 700.0, 500.0, 250.0), rng()
    believed = [errors.perturb_camera(camera, source) for _ in range(2000)]
    assert np.std([one.fx_px for one in believed]) == pytest.approx(0.7, rel=0.06)
    assert np.std([one.cy_px for one in believed]) == pytest.approx(2.0, rel=0.06)
    assert all(one.fx_px == one.fy_px for one in believed)


@pytest.mark.parametrize(
    "wrong", [{"position_noise_m": -1.0}, {"drift_time_s": 0.0}, {"dropped": 1.0}, {"clock_error_ns": -5}]
)
def test_invalid_error_settings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="expected"):
        Errors(**wrong)
    with pytest.raises(UsageError, match="at least 0"):
        MountingError(-0.1, 0.0)
