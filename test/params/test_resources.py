# SPDX-License-Identifier: Apache-2.0
"""Files of the package are found in a checkout and in an installation."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from wam_power_ros.params import resources

ROOT = Path(__file__).resolve().parents[2]


def test_a_checkout_uses_its_own_files() -> None:
    assert resources.share("package.xml") == ROOT / "package.xml"


def test_an_installed_package_uses_the_files_of_its_own_prefix(tmp_path: Path) -> None:
    package = tmp_path / "lib" / "python3.12" / "site-packages" / "wam_power_ros"
    (package / "params").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "params" / "__init__.py").touch()
    shutil.copy(resources.__file__, package / "params")
    wanted = tmp_path / "share" / "wam_power_ros" / "config" / "a.yaml"
    wanted.parent.mkdir(parents=True)
    wanted.touch()
    code = "from wam_power_ros.params.resources import share; print(share('config/a.yaml'))"
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=package.parent, capture_output=True, text=True, check=True
    )
    assert Path(found.stdout.strip()) == wanted.resolve()


def test_a_missing_file_is_named_with_the_searched_folders() -> None:
    with pytest.raises(FileNotFoundError, match=r"'config/none\.yaml'.*looked in"):
        resources.share("config/none.yaml")
