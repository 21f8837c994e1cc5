"""When refinements are due, and how many Gaussians there may be by then."""

from __future__ import annotations

from hybridworldsim.model.settings import Refinement


def due_refinements(refinement: Refinement, progress: float) -> int:
    """How many refinements are to have happened by a progress."""
    share = (progress - refinement.begin) / (refinement.end - refinement.begin)
    return min(max(int(share * refinement.times), 0), refinement.times)


def target_count(refinement: Refinement, done: int, first: int, most: int) -> int:
    """How many there are to be after so many refinements: in equal steps from the first number to the most."""
    return first + round((most - first) * min(1.2 * done / refinement.times, 1.0))
