"""``mirror VERB ...``: finds the verb's file and runs it.

Nothing heavy is imported before a verb is known, so that ``mirror --help`` answers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from mirror.stops import run_process

VERBS = {
    "demo": "make a synthetic street, ingest it, split it and write a report",
    "synth": "write recordings of a synthetic street",
    "ingest": "recordings -> traversals: trigger, write, ledger",
    "rois": "propose regions of interest from recordings",
    "index": "rebuild the derived tables of a dataset",
    "info": "say what a dataset or a recording is",
    "split": "freeze a train / held-out split, leak-checked",
    "stats": "the dataset-table row, distributions, plots",
    "check": "hold a dataset against the integrity rules",
    "report": "write an HTML report of a dataset",
    "submission": "write the template of a benchmark submission, or check one",
    "evaluate": "score a submission by a protocol",
    "reconstruct": "train a static model of a scene from its training traversals",
    "render": "render a model: a submission, or a new trajectory as video",
    "bake": "write a model as the PLY of 3D Gaussian Splatting, for viewers",
    "compare": "put results side by side, with paired significance",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        argv: the words after ``mirror``; default: the command line's, and then the process is the verb's own: signals
            end it.

    Returns:
        The exit code (`ExitCode`, or 130 if it was interrupted).
    """
    if argv is None:
        words = sys.argv[1:]
        return run_process(" ".join(["mirror", *words[:1]]), lambda: main(words))
    from mirror.command import run_command

    command = f"mirror {argv[0]}" if argv and argv[0] in VERBS else "mirror"
    return run_command(command, lambda: _run(list(argv)), as_json="--json" in argv)


def _run(words: list[str]) -> int:
    from mirror.errors import ExitCode
    from mirror.version import __version__

    if not words or words[0] in ("-h", "--help", "help"):
        print(_help())
        return ExitCode.DONE if words else ExitCode.COULD_NOT_RUN
    if words[0] in ("-V", "--version"):
        print(f"mirror {__version__}")
        return ExitCode.DONE
    verb, rest = words[0], words[1:]
    if verb not in VERBS:
        import difflib

        near = difflib.get_close_matches(verb, VERBS, n=1)
        hint = f" Did you mean `mirror {near[0]}`?" if near else ""
        print(f"mirror: no verb {verb!r}.{hint} `mirror --help` lists them.", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    return int(import_module(f"mirror.cli.{verb}").main(rest))


def _help() -> str:
    width = max(map(len, VERBS))
    lines = [
        "usage: mirror VERB [options]",
        "",
        "Fleet recordings become a multi-traversal camera dataset; simulators are scored against it.",
        "",
        *(f"  {verb:<{width}}  {text}" for verb, text in VERBS.items()),
        "",
        "`mirror VERB --help` explains a verb. Every verb that reports takes --json.",
        "Exit codes: 0 done; 1 findings or a failed check; 2 could not run or wrong usage;",
        "3 partly done (some items failed, the rest is complete); 130 interrupted.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
