# SPDX-License-Identifier: Apache-2.0
"""Location of the package's data files: `config/`, `urdf/`, `launch/`, `bags/`.

They are beside the package in a checkout, and under `<prefix>/share/wam_power_ros` once installed
(colcon, pip). Both are located from this module's own path, so that code and data always belong to
the same copy, whatever other workspaces are sourced.
"""

import os
import re
import tempfile
from pathlib import Path
from xml.etree import ElementTree

PACKAGE = "wam_power_ros"
PACKAGE_URL = "package://"
_LEVELS = 4  # folders above a xacro file in which packages are looked for


def share(relative: str) -> Path:
    """Return the existing path of a file or folder that comes with the package.

    A FileNotFoundError lists the searched folders.
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
    Packages that the file names are those of the sourced workspaces, and folders with a
    package.xml beside the file or above it: a vendor's description without ROS.
    A FileNotFoundError if there is none; a ValueError says what a xacro file lacks.
    """
    file = _in_package(urdf) if urdf.startswith(PACKAGE_URL) else share(os.path.expanduser(urdf))
    if file.suffix == ".xacro":
        return _expanded(file.resolve())
    data = file.read_bytes()
    declared = re.match(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([\w.-]+)", data)
    try:
        return data.decode(declared[1].decode() if declared else "utf-8-sig")
    except (LookupError, UnicodeDecodeError):
        return data.decode("latin-1")  # which all bytes are: urdfdom reads names as bytes


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
    path = os.environ.get("AMENT_PREFIX_PATH")
    with tempfile.TemporaryDirectory() as prefix:
        _add_packages(file, Path(prefix))
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join(filter(None, (prefix, path)))
        try:
            return str(xacro.process_file(str(file)).toxml())
        except Exception as error:  # also what an expression in the file raises
            cause = getattr(error, "exc", None) or error
            raise ValueError(
                f"{file} cannot be expanded by xacro: {cause}. A package that it names must be in "
                "a sourced workspace, or in a folder beside the file, with its package.xml"
            ) from None
        finally:
            if path is None:
                del os.environ["AMENT_PREFIX_PATH"]
            else:
                os.environ["AMENT_PREFIX_PATH"] = path


def _add_packages(file: Path, prefix: Path) -> None:
    """Make the packages beside and above a file known below an ament prefix."""
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    for folder in file.parents[:_LEVELS]:
        for found in (folder / "package.xml", *sorted(folder.glob("*/package.xml"))):
            try:
                name = ElementTree.parse(found).findtext("name", "").strip()
            except (OSError, ElementTree.ParseError):
                continue
            if name and "/" not in name and not (index / name).exists():
                (index / name).touch()
                (prefix / "share" / name).symlink_to(found.parent)
