"""The layer of the refined calibrations of one traversal."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from mirror.calibration.refinement.report import GAUGE, METHOD
from mirror.calibration.refinement.summary import CameraRefinement
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import DerivedLayer
from mirror.dataset.traversal import CameraCalibration
from mirror.schema.tables import CALIBRATIONS

SOURCE: Final = "refined"
DOCUMENT: Final = "refinement.json"
_LENS: Final = ("fx_px", "fy_px", "cx_px", "cy_px")


def refined_layer(view: Dataset, traversal_id: str, version: str, inputs: Mapping[str, str]) -> DerivedLayer:
    """Return the layer ``refined@VERSION`` of a traversal's calibrations; the layer may be missing.

    Args:
        view: the dataset.
        traversal_id: the traversal.
        version: version of the layer.
        inputs: hashes of what the result depends on.
    """
    described = "the same traversals, layers and settings"
    return DerivedLayer(view.layout, traversal_id, CALIBRATIONS.name, SOURCE, version, inputs, described)


def write_refined(
    view: Dataset, layer: DerivedLayer, cameras: Sequence[tuple[CameraCalibration, CameraRefinement]]
) -> None:
    """Write the layer of one traversal.

    A refined camera has a row of stage ``refined`` with the validity of the calibration that was refined. Calibrations
    that were not refined are copied with their stage, so that every image has a calibration in the layer.

    Args:
        view: the dataset; its layers name the calibrations that were refined.
        layer: the layer, which is missing.
        cameras: the calibrations that were refined, with the results.
    """
    writer = layer.open()
    refined = [(used, one) for used, one in cameras if one.status == "refined"]
    replaced = {(used.camera, used.valid_from_ns) for used, _ in refined}
    frames = view.where(traversal=layer.traversal_id).frames()
    rows = [dict(one.row) for one in frames[0].calibrations if (one.camera, one.valid_from_ns) not in replaced]
    rows += [_refined_row(used, one) for used, one in refined]
    rows.sort(key=lambda row: (row["camera"], row["stage"], row["valid_from_ns"] or 0))
    document = {"method": METHOD, "gauge": GAUGE, "cameras": [one.to_dict() for _, one in cameras]}
    writer.document(DOCUMENT, (json.dumps(document, indent=1) + "\n").encode())
    writer.finish(CALIBRATIONS, rows)


def _refined_row(used: CameraCalibration, one: CameraRefinement) -> dict[str, Any]:
    pose = {name: float(value[0]) for name, value in one.ego_SE3_camera.to_columns().items()}
    return {
        **used.row,
        **pose,
        **{name: getattr(one.lens, name) for name in _LENS},
        "stage": "refined",
        "covariance": one.covariance.ravel().tolist(),
        "method": f"mirror {METHOD}, from stage {used.stage}",
    }
