"""A split by list: roles follow the ids that the user names, as those of a published split."""

from __future__ import annotations

from collections.abc import Sequence

from mirror.dataset.splits.assignment import Assignment, describe_tie
from mirror.dataset.splits.candidates import Candidate
from mirror.dataset.splits.leaks import Tie
from mirror.errors import DatasetError
from mirror.schema.documents import ByList, Role


def assign(traversals: Sequence[Candidate], ties: Sequence[Tie], parameters: ByList) -> Assignment:
    """Assign the listed traversals; without a list for training, all others of their scenes are trained on.

    Args:
        traversals: the traversals to assign.
        ties: ties between traversals.
        parameters: the lists of ids.

    Raises:
        DatasetError: an id is unknown or in both lists, a scene with held-out traversals has none to train on, or a
            traversal of one list is tied to one of the other; the error names the ids.
    """
    scene_of = {item.traversal_id: item.scene_id for item in traversals}
    held_out = dict.fromkeys(parameters.held_out)
    scenes = {scene_of[key] for key in held_out if key in scene_of}
    train = dict.fromkeys(
        (key for key, scene_id in scene_of.items() if scene_id in scenes and key not in held_out)
        if parameters.train is None
        else parameters.train
    )
    for key in (*held_out, *train):
        if key not in scene_of:
            raise DatasetError(
                f"no traversal is called {key!r}",
                expected="ids of traversals of the scenes in question",
                remedy="list the ids: mirror sql DATASET 'select traversal_id from traversals'",
            )
        if key in held_out and key in train:
            raise DatasetError(f"{key} is in both lists", expected="one role for each traversal")
    trained_scenes = {scene_of[key] for key in train}
    for key in held_out:
        if scene_of[key] not in trained_scenes:
            raise DatasetError(
                f"{key} is held out of scene {scene_of[key]}, which has no traversal to train on",
                expected="at least one training traversal in each scene with a held-out one",
            )
        for tie in ties:
            other = next((one for one in tie.members if one in train), None) if key in tie.members else None
            if other is not None:
                raise DatasetError(
                    f"{other} would be trained on and {key} held out, but they {describe_tie(other, key, ties)}",
                    expected="held-out traversals that share no drive, no image and no time of one vehicle with"
                    " those to train on",
                    remedy="name the training traversals with --train-id and leave this one out",
                )
    roles: dict[str, Role] = dict.fromkeys(scene_of, "unused")
    roles.update(dict.fromkeys(train, "train"))
    roles.update(dict.fromkeys(held_out, "held_out"))
    return Assignment(roles, {})
