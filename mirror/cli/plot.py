"""``mirror plot DATASET --out FOLDER``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

_EXAMPLES = (
    "mirror plot demo/dataset --out plots",
    "mirror plot demo/dataset --scene street --figure map coverage --format pdf svg --out plots",
)


@dataclass(frozen=True)
class Arguments:
    """Draw figures of a dataset for print: map, coverage, conditions, categories, cameras, privacy."""

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """Folder of the figures; figures of the same names are replaced."""
    scene: Annotated[tuple[str, ...], help_text(default="all", metavar="ID ...")] = ()
    """Scenes to draw. A figure shows at most the 12 scenes with the most traversals."""
    figure: Annotated[tuple[str, ...], help_text(default="all", metavar="NAME ...")] = ()
    """Figures: traversals, conditions, speed, categories, map, coverage, place, cameras, privacy."""
    format: tuple[Literal["png", "svg", "pdf"], ...] = ("png",)
    """File formats."""
    dpi: int = 300
    """Resolution of PNG files and of images in the others."""
    json: bool = False
    """Print the paths of the files as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror plot", examples=_EXAMPLES)

    from mirror.dataset import open as open_dataset
    from mirror.schema.folders import FolderKind, require_output_folder
    from mirror.view.figures import FIGURES, draw_figures
    from mirror.view.privacy_figure import RemovedRegions

    unknown = [name for name in arguments.figure if name not in FIGURES]
    if unknown:
        raise UsageError(f"no figure {unknown[0]!r}", place="--figure", expected=f"one of {', '.join(FIGURES)}")
    if not 30 <= arguments.dpi <= 1200:
        raise UsageError(f"{arguments.dpi} dpi", place="--dpi", expected="30 to 1200")
    require_output_folder(arguments.out, FolderKind.OTHER)
    dataset = open_dataset(arguments.dataset).where(scene=arguments.scene or None)
    names, removed, files = arguments.figure or FIGURES, None, []
    if "privacy" in names:
        from mirror.privacy.summary import read_examples, summarize_redactions

        summary = summarize_redactions(dataset)
        if summary is not None:
            examples = [(one.kind, one.before, one.after) for one in read_examples(dataset)]
            removed = RemovedRegions(summary.regions, summary.covered_share, examples)
    for name, drawn in draw_figures(dataset, names, removed):
        for suffix in dict.fromkeys(arguments.format):
            files.append(arguments.out / f"{name}.{suffix}")
            _save(drawn, files[-1], arguments.dpi)
            if not arguments.json:
                print(files[-1], flush=True)
    if arguments.json:
        print(json.dumps({"figures": [str(file) for file in files]}))
    return ExitCode.DONE


def _save(figure: object, file: Path, dpi: int) -> None:
    import io

    from mirror.schema.files import write_bytes

    # Equal datasets give equal files.
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(file.suffix[1:], {})
    sink = io.BytesIO()
    figure.savefig(sink, dpi=dpi, format=file.suffix[1:], metadata=metadata)  # type: ignore[attr-defined]
    write_bytes(file, sink.getvalue())
