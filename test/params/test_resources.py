# SPDX-License-Identifier: Apache-2.0
"""Files of the package are found in a checkout and in an installation."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from wam_power_ros.params import resources
from wam_power_ros.params.resources import robot_description, share


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


PACKAGE_XML = "<package format='3'><name>lab_description</name></package>"
MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="tool" params="mass"><link name="tool"><inertial><mass value="${2 * mass}"/>
</inertial><visual><geometry><mesh filename="package://not_here/tool.stl"/></geometry></visual></link>
</xacro:macro></robot>"""
ARM = """<robot name="lab" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find lab_description)/tool.xacro"/><xacro:tool mass="0.3"/></robot>"""


def lab(folder: Path) -> Path:
    """A xacro file, and beside it the folder of the package that it includes."""
    package = folder / "checkout_of_the_vendor"
    package.mkdir()
    (package / "package.xml").write_text(PACKAGE_XML)
    (package / "tool.xacro").write_text(MACRO)
    file = folder / "arm.urdf.xacro"
    file.write_text(ARM)
    return file


@pytest.mark.parametrize("path", [None, "/opt/elsewhere"])
def test_a_xacro_file_is_expanded_with_the_packages_beside_it(
    path: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    if path is not None:
        monkeypatch.setenv("AMENT_PREFIX_PATH", path)
    text = robot_description(str(lab(tmp_path)))
    assert '<mass value="0.6"/>' in text
    assert "package://not_here" in text  # meshes are ignored
    assert os.environ.get("AMENT_PREFIX_PATH") == path


def test_a_package_that_a_xacro_file_does_not_find_is_named_with_the_remedy(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    file = lab(tmp_path)
    (tmp_path / "checkout_of_the_vendor/package.xml").unlink()
    with pytest.raises(ValueError, match=r"(?s)'lab_description' not found.*package\.xml"):
        robot_description(str(file))


def test_without_xacro_the_remedy_is_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(ValueError, match=r"arm\.urdf\.xacro .* pip install xacro"):
        robot_description(str(lab(tmp_path)))
    assert robot_description("urdf/wam7.urdf") == share("urdf/wam7.urdf").read_text()


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        ('<?xml version="1.0" encoding="ISO-8859-1"?>', "latin-1"),
        ('<?xml version="1.0" encoding="UTF-8"?>', "latin-1"),
        ('<?xml version="1.0" encoding="nonsense"?>', "latin-1"),
        ('<?xml version="1.0"?>', "latin-1"),
        ("", "utf-8-sig"),
    ],
)
def test_a_description_is_read_whatever_its_encoding(
    head: str, encoding: str, tmp_path: Path
) -> None:
    text = f"{head}<robot><!-- Prüfstand --></robot>"
    (file := tmp_path / "arm.urdf").write_bytes(text.encode(encoding))
    assert resources.robot_description(str(file)) == text


def test_a_description_is_found_in_a_sourced_package_or_at_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder := tmp_path / "share/lab/urdf").mkdir(parents=True)
    (folder / "arm.urdf").write_text("<robot/>")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    monkeypatch.setenv("HOME", str(folder))
    for urdf in ("package://lab/urdf/arm.urdf", "~/arm.urdf"):
        assert resources.robot_description(urdf) == "<robot/>"
    with pytest.raises(FileNotFoundError, match=r"package://lab/no.urdf is in none of.*nowhere"):
        resources.robot_description("package://lab/no.urdf")
    with pytest.raises(FileNotFoundError, match=r"'urdf/none\.urdf'.*looked in"):
        resources.robot_description("urdf/none.urdf")
