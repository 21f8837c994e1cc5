"""The verbs of ``mirror``: its own, and those of other installed packages."""

from __future__ import annotations

from typing import Final

from mirror.command import ENTRY_POINT_GROUP, Command, Group
from mirror.plugins import PluginKind

HEADINGS: Final[dict[Group, str]] = {
    "data": "Data",
    "reconstruction": "Reconstruction",
    "benchmark": "Benchmark",
}

_OWN: Final[dict[str, tuple[Group, str]]] = {
    "demo": ("data", "make a synthetic street, and run the verbs below on it"),
    "synth": ("data", "write recordings of a synthetic street"),
    "recording": ("data", "make a recording from a track and from images or videos"),
    "poses": ("data", "find the poses of a recording in its images, by structure from motion"),
    "rois": ("data", "propose regions of interest from recordings"),
    "ingest": ("data", "recordings -> traversals: trigger, write, ledger"),
    "index": ("data", "rebuild the derived tables of a dataset"),
    "info": ("data", "describe a dataset or a recording"),
    "split": ("data", "freeze a train / held-out split, checked for leaks"),
    "stats": ("data", "print the dataset-table row and distributions, draw plots"),
    "sql": ("data", "query the tables of a dataset with SQL"),
    "check": ("data", "check a dataset against the integrity rules"),
    "dataset": ("data", "publish a dataset without held-out images, fetch a published one, or take images down"),
    "report": ("data", "write an HTML report of a dataset"),
    "export": ("data", "write a scene for COLMAP, nerfstudio, gsplat, nuScenes or KITTI"),
    "plot": ("data", "draw figures of a dataset for print: map, coverage, conditions, cameras, privacy"),
    "view": ("data", "look at a dataset in rerun, or drive through a reconstructed street in the browser"),
    "deidentify": ("data", "remove faces, number plates and metadata from the images of a dataset"),
    "release": ("data", "check, review, build or withdraw a public release of a de-identified dataset"),
    "compile": ("data", "compile the kernels ahead of their first use, for containers and read-only homes"),
    "weights": ("data", "list files of weights, or fetch those that packages contain"),
    "annotate": ("data", "find road users: boxes from files, programs and networks; tracks"),
    "calibrate": ("data", "find a camera's lens, check the calibrations against the images, refine them"),
    "align": ("data", "bring passes of one street into one frame from their images"),
    "reconstruct": ("reconstruction", "train a static model of a scene from its training traversals"),
    "render": ("reconstruction", "render a model: a submission, or a new trajectory as video"),
    "export-ply": ("reconstruction", "write a model as the PLY of 3D Gaussian Splatting, for viewers"),
    "protocols": ("benchmark", "list the protocols, or print one as TOML"),
    "submission": ("benchmark", "write the template of a submission, or check one"),
    "evaluate": ("benchmark", "score a submission by a protocol"),
    "compare": ("benchmark", "compare results, with paired significance"),
}


RENAMED: Final = {"bake": "export-ply"}
"""New names by old names of verbs; the old ones are still accepted."""


VERBS: Final = PluginKind("verb", ENTRY_POINT_GROUP, "mirror VERB", "all", takes_files=False)


def find_command(verb: str) -> Command | None:
    """Return the command of a verb; None if there is no such verb.

    Raises:
        UsageError: its package cannot be loaded.
    """
    if verb in _OWN:
        return _own(verb)
    return VERBS.load(verb) if verb in VERBS.names() else None


def verb_names() -> list[str]:
    """List the names of the installed verbs, MIRROR's own first; no verb is loaded."""
    return [*_OWN, *VERBS.names()]


def all_commands() -> dict[str, Command]:
    """Return the commands of all installed verbs, MIRROR's own first."""
    return {**{verb: _own(verb) for verb in _OWN}, **VERBS.load_all()}


def _own(verb: str) -> Command:
    group, summary = _OWN[verb]
    return Command(group, summary, f"mirror.cli.{verb.replace('-', '_')}")
