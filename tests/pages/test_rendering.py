"""Templates: everything is escaped, a missing value is an error, and nothing is loaded before a page is made."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from jinja2 import TemplateNotFound, UndefinedError
from markupsafe import Markup

from mirror.pages.rendering import load_environment, render_page, render_part, script_data, style_sheet
from tests.pages.templates import ROOT, SOURCES, TEMPLATES, package_of

NASTY = "<script>alert(1)</script> \"'&"
ESCAPED = "&lt;script&gt;alert(1)&lt;/script&gt; &#34;&#39;&amp;"


def test_table_escapes_strings_and_keeps_parts() -> None:
    rows = [[NASTY, Markup("<b>bold</b>")]]
    table = render_part("mirror.pages", "parts.html", "table", [NASTY, "n:figure"], rows)
    assert "<script" not in table
    assert table.count(ESCAPED) == 2
    assert '<td class="n"><b>bold</b></td>' in table
    assert '<th class="n">figure</th>' in table


@pytest.mark.parametrize(("macro", "values"), [("tiles", [[(NASTY, NASTY)]]), ("image", [NASTY, 1, 1, ""])])
def test_parts_escape_their_values(macro: str, values: list[object]) -> None:
    part = render_part("mirror.pages", "parts.html", macro, *values)
    assert "<script" not in part and ESCAPED in part


def test_data_of_a_script_cannot_end_it() -> None:
    assert "<" not in script_data({"</script>": "<!--"})


def test_missing_values_and_templates_are_errors() -> None:
    with pytest.raises(UndefinedError, match="head"):
        render_part("mirror.pages", "parts.html", "table")
    with pytest.raises(TemplateNotFound, match="absent"):
        render_page("mirror.pages", "absent.html")


def test_style_sheet_needs_no_network() -> None:
    assert "url(" not in style_sheet() and "@import" not in style_sheet() and "</" not in style_sheet()


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.stem)
def test_each_page_has_the_layout_and_no_escape_is_turned_off(template: Path) -> None:
    text = template.read_text()
    assert "|safe" not in text.replace(" ", "") and "autoescape" not in text
    if "<html" in text or "{% extends" in text:
        assert ("<html" in text) == (template.parent == ROOT / "mirror" / "pages" / "templates")
    for word in (" style=", "<style", " onclick=", " onload="):
        if word == " style=":
            # Figures set properties that the style sheet uses.
            assert text.count(word) == text.count(' style="--'), template.name
        elif template.name != "layout.html":
            assert word not in text


def test_only_the_helper_marks_strings_as_html() -> None:
    marking = [
        path.relative_to(ROOT).as_posix()
        for path in SOURCES
        if "Markup(" in path.read_text() or "html import escape" in path.read_text()
    ]
    assert marking == ["mirror/pages/rendering.py"]


def test_every_template_compiles() -> None:
    # Only a template's syntax and the names of its filters are checked here.
    for template in TEMPLATES:
        load_environment(package_of(template)).get_template(template.name)


def test_templates_are_loaded_by_the_first_page() -> None:
    code = "import sys, mirror.view.report, mirror.cli.main; print('jinja2' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
