"""Where verbs print tables and messages: text from files and arguments stands there as it is, never as markup."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def plain_console(*, stderr: bool = False, width: int | None = None, soft_wrap: bool = False) -> Console:
    """Make a console that prints every string literally, in table cells and titles too.

    Brackets (``[/b]``, ``[Date]``) are neither styles nor ends of styles, ``:name:`` is no emoji, and numbers are not
    coloured. What has a style is a `rich.text.Text`.

    Args:
        stderr: standard error, not standard output.
        width: columns; None: those of the terminal.
        soft_wrap: leave the breaking of long lines to the terminal.
    """
    from rich.console import Console

    return Console(stderr=stderr, width=width, soft_wrap=soft_wrap, markup=False, emoji=False, highlight=False)
