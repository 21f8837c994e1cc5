"""Covariance of a solution of the equations of tracked images, and the sources of its uncertainty.

The covariance is a sandwich: the scatter of the pairs of images and the priors, between two inverse information
matrices (P. Huber 1967; to first order the jackknife over pairs). The parts are independent, so the variance of a
rotation is the sum of those of its sources: an error of a source with a large share looks like the rotation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.equations import Solution

TRACKS: Final = "tracks"
MOTION: Final = "motion"
"""The weak prior of the rotations: it has a large share where the motion does not show an axis."""


class Uncertainty:
    """The covariance of a solution.

    Args:
        solution: the solution of P unknowns.

    Attributes:
        covariance: (P, P) covariance of the unknowns.
    """

    def __init__(self, solution: Solution) -> None:
        state, prior = solution.state, solution.problem.prior_information
        scores = np.zeros((len(state.gradients), len(solution.unknowns)))
        np.put_along_axis(scores, state.columns, state.gradients, axis=1)
        self._problem = solution.problem
        self._inverse = np.linalg.inv(state.information)
        self._scores = scores
        # Cameras without tracks have no scatter, only their weak prior.
        self.covariance: Float64 = self._inverse @ (prior + scores.T @ scores) @ self._inverse

    def variance_by_source(self, columns: Int64, turn: Float64) -> dict[str, Float64]:
        """Return the variances of a rotation about three axes, separately for each source of error.

        Args:
            columns: (3,) positions of the rotation among the unknowns.
            turn: (3, 3) rotation to the axes.

        Returns:
            (3,) variances by source, rad^2; their sum is the diagonal of the covariance.
        """
        gain = turn @ self._inverse[columns]
        prior = self._problem.prior_information
        found = {TRACKS: ((gain @ self._scores.T) ** 2).sum(axis=1)}
        for name, own in self._sources().items():
            found[name] = np.einsum("ai,ij,aj->a", gain[:, own], prior[np.ix_(own, own)], gain[:, own])
        return found

    def _sources(self) -> Mapping[str, Int64]:
        """Positions among the unknowns by name of what they correct."""
        problem = self._problem
        poses, mounts = np.split(np.arange(problem.scale_column).reshape(-1, 6), [len(problem.rig.time_s)])
        return {
            "recorded rotations": poses[:, :3].ravel(),
            "recorded positions": poses[:, 3:].ravel(),
            "positions of the cameras": mounts[:, 3:].ravel(),
            "focal length": problem.scale_column + np.arange(len(problem.rig.cameras)),
            **({} if problem.times is None else {"times of the cameras": problem.time_columns.ravel()}),
            "length of the way": np.array([problem.size - 1]),
            MOTION: mounts[:, :3].ravel(),
        }


def jackknife_variance(solution: Solution) -> Float64:
    """Return the variances (P,) of the unknowns over solutions that each leave out one pair of images, and the priors.

    `Uncertainty` has the first order of this. It is too small for an unknown that few pairs show: these pairs move the
    solution towards themselves, and what is left over of their scatter is small.
    """
    state, prior = solution.state, solution.problem.prior_information
    inverse = np.linalg.inv(state.information)
    moved = np.empty((len(state.gradients), len(solution.unknowns)))
    for pair, (columns, gradient, block) in enumerate(zip(state.columns, state.gradients, state.blocks, strict=True)):
        without = state.information.copy()
        without[np.ix_(columns, columns)] -= block
        score = np.zeros(len(solution.unknowns))
        score[columns] = gradient
        moved[pair] = np.linalg.solve(without, score)
    return np.asarray((moved**2).sum(axis=0) + ((inverse @ prior) * inverse).sum(axis=1))
