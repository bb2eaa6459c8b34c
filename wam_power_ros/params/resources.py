# SPDX-License-Identifier: Apache-2.0
"""Location of the package's data files: `config/`, `urdf/`, `launch/`, `bags/`.

They are beside the package in a checkout, and under `<prefix>/share/wam_power_ros` once installed
(colcon, pip). Both are located from this module's own path, so that code and data always belong to
the same copy, whatever other workspaces are sourced.
"""

from pathlib import Path

PACKAGE = "wam_power_ros"


def share(relative: str) -> Path:
    """Return the existing path of a file or folder that comes with the package.

    Args:
        relative: Path below the checkout or the share folder, e.g. `"config/learner.yaml"`.

    Raises:
        FileNotFoundError: There is no such file or folder; the message lists the searched folders.
    """
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent
    folders = [checkout] if (checkout / "package.xml").is_file() else []
    folders += [ancestor / "share" / PACKAGE for ancestor in package.parents]
    for folder in folders:
        if (folder / relative).exists():
            return folder / relative
    searched = ", ".join(map(str, folders))
    raise FileNotFoundError(f"{relative!r} is not part of {PACKAGE}; looked in: {searched}")
