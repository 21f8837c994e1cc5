"""Tests that the files and commands that the documents name exist."""

import re
from pathlib import Path

import pytest

from mirror.cli.verbs import all_commands
from mirror.export.run import LAYOUTS
from mirror.schema.documents import NovelTraversal, Roi

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *PAGES])
LINKED = [*DOCUMENTS, *sorted((ROOT / "benchmarks").rglob("*.md"))]
GUIDES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "docs" / "architecture.md"]
PACKAGES = ("mirror", "hybridworldsim", "mirror_baselines", "mirror_leaderboard")
FOLDERS = ("mirror", "baselines", "leaderboard", "benchmarks", "tests", "docs", "examples")


def name_page(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("document", LINKED, ids=name_page)
def test_relative_links_lead_to_files_and_headings(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, heading = target.partition("#")
        path = document.parent / name if name else document
        assert path.exists(), target
        if heading:
            lines = [line.lstrip("# ") for line in path.read_text().splitlines() if line.startswith("#")]
            anchors = {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in lines}
            assert heading in anchors, target


@pytest.mark.parametrize("document", GUIDES, ids=name_page)
def test_paths_in_the_guides_exist(document: Path) -> None:
    """A file may be named by the end of its path, such as `ingest/trigger.py`; a folder by a path from the root."""
    files = [f"/{path.relative_to(ROOT)}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    for name in re.findall(r"`([\w./-]+)`", document.read_text()):
        if name.endswith(".py"):
            assert any(path.endswith(f"/{name}") for path in files), name
        elif "/" in name and name.split("/")[0] in (*FOLDERS, *PACKAGES):
            assert any((base / name).exists() for base in (ROOT, ROOT / "baselines", ROOT / "leaderboard")), name


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_page)
def test_commands_in_the_documents_exist(document: Path) -> None:
    """Commands at the beginning of a line or of inline code: verbs of `mirror`, modules, targets of make."""
    if document.name == "CHANGELOG.md":
        pytest.skip("the changelog names commands of earlier versions")
    text = document.read_text()
    verbs = {*all_commands(), "VERB", "--help", "--version"}
    for verb in re.findall(r"(?:^|`)mirror ([\w-]+)", text, re.M):
        assert verb in verbs, verb
    for module in re.findall(r"(?:^|`)python -m ([\w.]+)", text, re.M):
        path = module.replace(".", "/")
        assert any((ROOT / f"{path}{end}").exists() for end in (".py", "/__main__.py")), module
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M))
    for target in re.findall(r"(?:^|`)make (\w+)", text, re.M):
        assert target in targets, target


def test_the_architecture_names_every_package() -> None:
    table = (ROOT / "docs" / "architecture.md").read_text()
    packages = [folder for folder in (ROOT / "mirror").iterdir() if (folder / "__init__.py").is_file()]
    named = [f"mirror/{folder.name}" for folder in packages if folder.name != "cli"]
    assert not [name for name in named if f"`{name}`" not in table]
    model = next(line for line in table.splitlines() if line.startswith("| `baselines/hybridworldsim`"))
    own = [path.parent.name for path in (ROOT / "baselines" / "hybridworldsim").glob("*/__init__.py")]
    shown = {"mvs": "multi-view stereo"}
    assert not [name for name in own if shown.get(name, name) not in model]


GENERATED = ("metrics.md", "rules.md", "schema.md")


@pytest.mark.parametrize("document", PAGES, ids=name_page)
def test_a_page_begins_with_a_sentence_and_says_what_does_not_work(document: Path) -> None:
    head, first, *_ = [block.strip() for block in document.read_text().split("\n\n")]
    title, _, rest = head.partition("\n")
    first = rest.strip() or first
    assert title.startswith("# ")
    # A sentence, not a block of code, a list, a table or another heading.
    assert re.match(r"[A-Z`*].*[a-z]", first) and not first.startswith(("```", "- ", "* ", "| ", "#")), first[:80]
    assert "." in first or ":" in first
    text = document.read_text()
    if document.name not in GENERATED:
        # The table of a format says what of it is lost.
        limits = r"^(## (What does not work|What it cannot do|Limits)$|\| lost \|)"
        assert re.search(limits, text, re.M), "no section of limits"
    if document.name not in GENERATED:
        assert count_prose(text) <= 1500, "split the page by ideas, and move a study to its folder"


@pytest.mark.parametrize("study", sorted((ROOT / "benchmarks" / "studies").glob("*/benchmark.py")), ids=name_page)
def test_a_study_says_in_600_words_what_was_asked_found_and_where_it_loses(study: Path) -> None:
    text = study.with_name("README.md").read_text()
    assert len(text.split()) <= 600
    assert text.startswith("# Study of ") and re.search(r"^This study asks ", text, re.M)
    for part in ("**Question.**", "**Found.**", "**Repeat it.**"):
        assert part in text, part
    assert "**Where we lose.**" in text or "**Where it fails.**" in text
    assert len(re.findall(r"^\|---", text, re.M)) == 1, "one table; others stand in report.md"


@pytest.mark.parametrize(
    "page",
    [
        page
        for page in (ROOT / "README.md", *PAGES, *(ROOT / "benchmarks" / "studies").glob("*/README.md"))
        if "![" in page.read_text()
    ],
    ids=name_page,
)
def test_an_image_has_a_caption(page: Path) -> None:
    """A paragraph in italics under the image says what to see, what it cost, and its command."""
    text = page.read_text()
    captions = re.findall(r"^!\[[^\n]+\]\([^\n]+\)\n\n(.*?)(?:\n\n|\Z)", text, re.M | re.S)
    assert len(captions) == text.count("\n![")
    for caption in captions:
        assert re.fullmatch(r"\*[^*].*\*", caption, re.S), caption


def count_prose(text: str) -> int:
    """Return the number of words outside of blocks of code and tables."""
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.M | re.S)
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("|")]
    return len(" ".join(lines).split())


def test_figures_of_the_readme_are_those_of_the_pages() -> None:
    """Each figure of the table of capabilities stands in docs/performance.md beside its benchmark, or in the study."""
    readme = (ROOT / "README.md").read_text()
    table = readme.split("| capability |")[1].split("\n\n")[0].splitlines()[2:]
    performance = (ROOT / "docs" / "performance.md").read_text().splitlines()
    study = (ROOT / "benchmarks" / "studies" / "static_reconstruction" / "report.md").read_text()
    assert len(table) >= 8
    checked = 0
    for row in table:
        _, figures, command = (cell.strip() for cell in row.strip("| ").split(" | "))
        name = command.strip("`").split()[0]
        assert (
            (ROOT / "benchmarks" / name).is_dir()
            or (ROOT / "benchmarks" / f"{name}.py").is_file()
            or (ROOT / "benchmarks" / "studies" / name).is_dir()
        ), name
        lines = [line for line in performance if f"(`{name}`)" in line]
        for figure in re.findall(r"\d[\d.]* ms|\de-\d+", figures):
            assert any(re.search(rf"(?<![\d.]){re.escape(figure)}", line) for line in lines), (name, figure)
            checked += 1
        for method, psnr in re.findall(r"`([\w-]+)`: ([\d.]+) dB", figures):
            values = [float(value) for value in re.findall(rf"^\| {method} \| (\d+\.\d+) \|", study, re.M)]
            assert round(values[0], 1) == float(psnr)
            checked += 1
    assert checked >= 8


def test_counts_of_the_readme_are_those_of_the_code() -> None:
    readme = (ROOT / "README.md").read_text()
    split = NovelTraversal()
    assert f"# {split.train} traversals of each scene train, {split.held_out} is held out" in readme
    assert f"a circle of {Roi.model_fields['radius_m'].default:g} m" in readme


def test_export_formats_of_the_readme_exist() -> None:
    readme = (ROOT / "README.md").read_text()
    ((first, others),) = re.findall(r"mirror export (\w+) .*# also ([\w, ]+)", readme)
    assert {first, *others.replace(",", " ").split()} <= set(LAYOUTS)


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().split()) <= 900
