"""Commands that install or upgrade this toolkit from where it came, for remedies.

The distribution's name is no use to pip before it is registered at an index: pip then takes the checkout or the address
that the toolkit was installed from.
"""

from __future__ import annotations

import json
import shlex
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

NAME: Final = "mirror-dataset"
"""Of the distribution."""


def install_command(extra: str) -> str:
    """Return the command that adds an extra's packages.

    Args:
        extra: its name, such as ``view``.
    """
    return _command("pip install", f"[{extra}]")


def upgrade_command() -> str:
    """Return the command that installs the newest version."""
    checkout = checkout_folder()
    if checkout is not None:
        return f"git -C {shlex.quote(str(checkout))} pull && {_command('pip install --upgrade', '')}"
    return _command("pip install --upgrade", "")


def _command(words: str, extra: str) -> str:
    checkout, address = checkout_folder(), _address()
    if checkout is not None:
        return f"{words} -e {shlex.quote(f'{checkout}{extra}')}"
    if address is None:
        return f"{words} {shlex.quote(f'{NAME}{extra}')}"
    return f"{words} {shlex.quote(f'{NAME}{extra} @ {address}')}"


def checkout_folder() -> Path | None:
    """Return the folder of the repository that this module is imported from; None if the package is installed."""
    root = Path(__file__).resolve().parents[1]
    try:
        return root if f'name = "{NAME}"' in (root / "pyproject.toml").read_text() else None
    except OSError:
        return None


def _address() -> str | None:
    """The URL that pip installed the toolkit from (PEP 610); None: an index."""
    try:
        text = distribution(NAME).read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    if text is None:
        return None
    said = json.loads(text)
    url = str(said["url"])
    if "vcs_info" in said:
        revision = said["vcs_info"].get("requested_revision")
        return f"{said['vcs_info']['vcs']}+{url}" + (f"@{revision}" if revision else "")
    if urlsplit(url).scheme == "file" and not Path(unquote(urlsplit(url).path)).exists():
        return None
    return url
