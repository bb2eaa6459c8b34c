# SPDX-License-Identifier: Apache-2.0
"""Files of the package are found in a checkout and in an installation."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from wam_power_ros.params import resources
from wam_power_ros.params.resources import robot_description, share

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


ARM = """<robot name="lab" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="mass" value="0.3"/><link name="tool"><inertial><mass value="${2 * mass}"/>
</inertial></link>%s</robot>"""


def test_a_xacro_file_is_expanded_and_a_package_that_is_not_found_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/nowhere")
    (file := tmp_path / "arm.urdf.xacro").write_text(ARM % "")
    assert '<mass value="0.6"/>' in robot_description(str(file))
    file.write_text(ARM % '<xacro:include filename="$(find lab_description)/tool.xacro"/>')
    with pytest.raises(ValueError, match=r"(?s)'lab_description' not found.*sourced workspace"):
        robot_description(str(file))


def test_without_xacro_the_remedy_is_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    (file := tmp_path / "arm.urdf.xacro").touch()
    with pytest.raises(ValueError, match=r"arm\.urdf\.xacro .* pip install xacro"):
        robot_description(str(file))
    assert robot_description("urdf/wam7.urdf") == share("urdf/wam7.urdf").read_text()


def test_a_description_is_read_whatever_the_encoding_of_its_comments(tmp_path: Path) -> None:
    text = "<robot><!-- Prüfstand --></robot>"
    for encoding in ("utf-8", "utf-8-sig", "latin-1"):
        (file := tmp_path / "arm.urdf").write_bytes(text.encode(encoding))
        found = resources.robot_description(str(file))
        assert found.startswith("<robot><!-- Pr") and found.endswith("fstand --></robot>")


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
