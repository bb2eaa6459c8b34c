# SPDX-License-Identifier: Apache-2.0
"""`wam-power view`: a page that shows a session or a bag in a browser."""

from __future__ import annotations

import signal
from pathlib import Path

from wam_power_ros.cli.launcher import UsageError, interrupt, session_environment
from wam_power_ros.cli.session_options import existing_session


def view(path: Path | None, address: str, port: int) -> int:
    """Serve the page until Ctrl-C."""
    from wam_power_ros.practice.session import Session

    try:
        from wam_power_ros.view import guarded_server, viewer
    except ImportError as error:
        raise UsageError(
            f"the page needs viser ({error}): pip install 'viser>=1.1.1,<1.2'"
        ) from None
    is_bag = path is not None and not Session.exists(path) and path.exists()
    folder = path.resolve() if is_bag else existing_session(path)
    signal.signal(signal.SIGTERM, interrupt)
    server = guarded_server.open_server(address, port)
    try:
        host = f"[{address}]" if ":" in address else address
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
