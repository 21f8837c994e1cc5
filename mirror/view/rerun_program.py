"""Opens the program of rerun for this machine alone.

`rerun.spawn` cannot name an address, and the program listens on all interfaces unless an option says otherwise: every
machine of the network could read what is shown.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sysconfig
import time
from collections.abc import Sequence
from typing import Final

from mirror.errors import UsageError

_HOST: Final = "127.0.0.1"
_OPENS_S: Final = 10.0
_POLL_S: Final = 0.05


def open_viewer(port: int, options: Sequence[str] = ()) -> subprocess.Popen[bytes]:
    """Open rerun's viewer, which stays open after this process, and wait until the viewer listens.

    Args:
        port: port of the viewer, on the loopback interface.
        options: further options of the program.

    Raises:
        UsageError: the program is not there, or it ends before it listens, as it does without a display.
    """
    # A Python that is called by its path does not have its own programs in PATH.
    search = os.pathsep.join((os.environ.get("PATH", os.defpath), sysconfig.get_path("scripts")))
    program = shutil.which("rerun", path=search)
    if program is None:
        raise _closed("the program rerun is missing")
    viewer = subprocess.Popen(
        [program, "--port", str(port), "--bind", _HOST, *options],
        env={**os.environ, "RERUN_APP_ONLY": "true"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    end = time.monotonic() + _OPENS_S
    while time.monotonic() < end:
        has_ended = viewer.poll() is not None
        if _is_listening(port):
            return viewer
        # A viewer that is open already takes over, and the new one ends.
        if has_ended:
            raise _closed(f"it ended with code {viewer.returncode}")
        time.sleep(_POLL_S)
    viewer.terminate()
    raise _closed(f"it does not listen at {_HOST}:{port} after {_OPENS_S:.0f} s")


def _is_listening(port: int) -> bool:
    try:
        socket.create_connection((_HOST, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def _closed(reason: str) -> UsageError:
    return UsageError(
        f"rerun's viewer does not open: {reason}",
        expected="a display, and the program rerun of the package rerun-sdk",
        remedy="write a file with --save FILE.rrd, and open it where there is a display: rerun FILE.rrd",
    )
