"""TAB005."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.cameras import COEFFICIENTS
from mirror.recordings.calibration import STAGES, Calibration

VOCABULARY = {
    ("ego_poses", "orientation"): ("recorded", "course"),
    ("images", "codec"): ("jpeg", "png", "video"),
    ("images", "privacy"): ("raw", "redacted"),
    ("calibrations", "stage"): STAGES,
    ("calibrations", "model"): tuple(COEFFICIENTS),
    ("calibrations", "shutter_direction"): get_args(Calibration.model_fields["shutter_direction"].annotation),
    ("masks", "kind"): ("dynamic", "ego", "sky", "instance"),
    ("points", "kind"): ("background", "ground", "far"),
}


@scene_rule("TAB005", Severity.ERROR, remedy="write the table again with the words that docs/schema.md lists")
def unknown_word(view: SceneView) -> Iterator[Finding]:
    """A column holds a word that its schema does not know."""
    for rows in view.tables():
        for (table, name), known in VOCABULARY.items():
            if table == rows.table.name:
                codes, words = rows.words(name)
                unknown = [code for code, word in enumerate(words) if word not in known]
                yield from rows.findings(
                    np.isin(codes, unknown),
                    lambda row, name=name, known=known, rows=rows: (  # type: ignore[misc]
                        f"{name} is {rows.word(name, row)!r}; expected {', '.join(known)}"
                    ),
                )
