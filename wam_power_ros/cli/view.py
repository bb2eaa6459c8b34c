# SPDX-License-Identifier: Apache-2.0
"""`wam-power view`: a page that shows a session or a bag in a browser."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path

from wam_power_ros.cli.launcher import UsageError, interrupt, session_environment
from wam_power_ros.cli.session_options import existing_session


def view(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    from wam_power_ros.practice.session import Session

    try:
        from wam_power_ros.view import guarded_server, viewer
    except ImportError as error:
        raise UsageError(
            f"the page needs viser ({error}): pip install 'viser>=1.1.1,<1.2'"
        ) from None
    path: Path | None = options.path
    is_bag = path is not None and not Session.exists(path) and path.exists()
    folder = path.resolve() if is_bag else existing_session(path)
    signal.signal(signal.SIGTERM, interrupt)
    server = guarded_server.open_server(options.address, options.port)
    try:
        host = f"[{options.address}]" if ":" in options.address else options.address
        url = f"http://{host}:{server.get_port()}"
        ready = lambda: print(f"{url}  (Ctrl-C ends it)", flush=True)  # noqa: E731
        if is_bag:
            viewer.of_bag(server, folder, ready)
        else:
            viewer.of_session(server, folder, ready, session_environment)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
    return 0
