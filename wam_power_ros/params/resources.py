# SPDX-License-Identifier: Apache-2.0
"""Location of the package's data files: `config/`, `urdf/`, `launch/`, `bags/`.

They are beside the package in a checkout, and under `<prefix>/share/wam_power_ros` once installed
(colcon, pip). Both are located from this module's own path, so that code and data always belong to
the same copy, whatever other workspaces are sourced.
"""

import os
from pathlib import Path

PACKAGE = "wam_power_ros"
PACKAGE_URL = "package://"


def share(relative: str) -> Path:
    """Return the existing path of a file or folder that comes with the package.

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


def robot_description(urdf: str) -> str:
    """Read a URDF; a file that ends in .xacro is expanded.

    Its path is absolute, from ~, as for `share`, or of a sourced package: package://NAME/FILE.
    Packages that a xacro file names are those of the sourced workspaces.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A xacro file cannot be expanded; the message says what is missing.
    """
    file = _in_package(urdf) if urdf.startswith(PACKAGE_URL) else share(os.path.expanduser(urdf))
    if file.suffix == ".xacro":
        return _expanded(file.resolve())
    return file.read_text(encoding="utf-8-sig", errors="replace")  # some comments are latin-1


def _in_package(url: str) -> Path:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for file in (Path(each, "share", url.removeprefix(PACKAGE_URL)) for each in prefixes):
        if file.is_file():
            return file
    raise FileNotFoundError(f"{url} is in none of the sourced packages in {prefixes}")


def _expanded(file: Path) -> str:
    try:
        import xacro
    except ImportError:
        raise ValueError(
            f"{file} is a xacro file, and Python has no xacro to expand it: pip install xacro, or "
            "apt install ros-jazzy-xacro"
        ) from None
    try:
        return str(xacro.process_file(str(file)).toxml())
    except Exception as error:  # also what an expression in the file raises
        cause = getattr(error, "exc", None) or error
        raise ValueError(
            f"{file} cannot be expanded by xacro: {cause}. A package that it names must be in a "
            "sourced workspace"
        ) from None
