"""When refinements are due, and how many Gaussians there may be after each."""

from __future__ import annotations

from hybridworldsim.model.settings import AnchorRefinement


def due_refinements(refinement: AnchorRefinement, progress: float) -> int:
    """Return the number of refinements that are due at a progress from 0 to 1."""
    share = (progress - refinement.begin) / (refinement.end - refinement.begin)
    return min(max(int(share * refinement.times), 0), refinement.times)


def target_count(refinement: AnchorRefinement, refinement_number: int, initial_count: int, max_count: int) -> int:
    """Return the number of Gaussians after a refinement.

    It rises in equal steps from the initial to the largest number.
    """
    return initial_count + round((max_count - initial_count) * min(1.2 * refinement_number / refinement.times, 1.0))
