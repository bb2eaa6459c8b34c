# SPDX-License-Identifier: Apache-2.0
"""Where the files that are not Python live: `config/`, `urdf/`, `launch/`, `bags/`.

They stand beside the package in a checkout and under `<prefix>/share/wam_power_ros` once installed
(colcon, pip). Both are found from the running module itself, so code and data are always of the
same copy, whatever other workspaces are sourced.
"""

from pathlib import Path

PACKAGE = "wam_power_ros"


def share(relative: str) -> Path:
    """Path of a file or folder that comes with the package.

    Args:
        relative: Path below the checkout or the share folder, e.g. `"config/learner.yaml"`.

    Returns:
        An existing path.

    Raises:
        FileNotFoundError: When it is in none of the places, which the message lists.
    """
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent
    places = [checkout] if (checkout / "package.xml").is_file() else []
    places += [ancestor / "share" / PACKAGE for ancestor in package.parents]
    for place in places:
        if (place / relative).exists():
            return place / relative
    looked = ", ".join(str(place) for place in places)
    raise FileNotFoundError(f"{relative!r} does not come with {PACKAGE}; looked in: {looked}")
