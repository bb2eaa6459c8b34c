# SPDX-License-Identifier: Apache-2.0
"""Build backend of pip for a machine without ROS: a wheel of the interfaces, by gcc and g++ alone.

The wheels of rclpy bring rosidl's generators, headers and libraries. This does what rosidl's CMake
files do: definitions, IDL, type hashes, C and Python sources, shared libraries. These go to
PREFIX/lib, where the start of rclpy's wheels looks for libraries.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
import json
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
OTHERS = sorted(path.parent for path in (ROOT / "without_ros").glob("*/msg"))  # of ROS, by package
NAME, VERSION = ROOT.name, ElementTree.parse(ROOT / "package.xml").findtext("version")
DATA, INFO = f"{NAME}-{VERSION}.data/data", f"{NAME}-{VERSION}.dist-info"
INDEX = "share/ament_index/resource_index"
DISPATCH = "rosidl_typesupport_c"  # chooses one of:
SUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
LIBRARIES = ["rosidl_generator_c", *SUPPORTS, DISPATCH, "rosidl_generator_py"]


def get_requires_for_build_wheel(config_settings: object = None) -> list[str]:
    """Requirements of an isolated build, from the one list of versions."""
    lines = (ROOT.parent / "requirements.txt").read_text().splitlines()
    return [line for line in lines if line.startswith(("ros-", "numpy"))]


def build_wheel(folder: str, config_settings: object = None, metadata: object = None) -> str:
    """Build the wheel of this package, with those packages that no other wheel has brought."""
    headers = Path(sysconfig.get_path("include"), "Python.h")
    if not (shutil.which("gcc") and shutil.which("g++") and headers.exists()):
        sys.exit(f"gcc, g++ and {headers} are needed: apt install build-essential python3-dev")
    brought = importlib.metadata.packages_distributions()
    packages = [ROOT, *(it for it in OTHERS if {*brought.get(it.name, ())} <= {NAME})]
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tag = f"{python}-{python}-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
    with tempfile.TemporaryDirectory() as name:
        wheel, sources = Path(name, "wheel"), Path(name, "sources")
        for package in packages:
            generate(package, sources, wheel)
            compile_libraries(package.name, sources, wheel)
        info = wheel / INFO
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {NAME}\nVersion: {VERSION}\n")
        (info / "WHEEL").write_text(f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {tag}\n")
        return pack(wheel, Path(folder, f"{NAME}-{VERSION}-{tag}.whl"))


def wheels_prefix() -> Path:
    """Folder whose lib/, include/ and share/ have what the wheels of rclpy bring."""
    import rosidl_adapter

    return Path(rosidl_adapter.__file__).parents[4]  # of lib/python3.x/site-packages


def generate(package: Path, sources: Path, wheel: Path) -> None:
    """Write IDL, type hashes and Python of a package into the wheel, and C into `sources`."""
    from rosidl_adapter import convert_to_idl

    name, prefix, kinds = package.name, wheels_prefix(), ("msg", "srv", "action")
    definitions = [path for kind in kinds for path in sorted(package.glob(f"{kind}/*.{kind}"))]
    shared, index = wheel / DATA / "share" / name, wheel / DATA / INDEX
    for path in definitions:
        convert_to_idl(package, name, path.relative_to(package), shared)
        shutil.copy(path, shared / path.parent.name)
    idls = [f"{path.parent.name}/{path.stem}.idl" for path in definitions]
    others = [path.name for path in (prefix / INDEX / "rosidl_interfaces").iterdir()]

    def run(generator: str, function: str, place: Path, *more: object) -> None:
        """Run a generator, which writes to `place`."""
        for kind in kinds:
            (place / kind / "detail").mkdir(parents=True, exist_ok=True)
        templates = prefix / "share" / generator / "resource"
        for template in templates.glob("*visibility_control.h.in"):
            text = template.read_text().replace("@PROJECT_NAME@", name)
            header = text.replace("@PROJECT_NAME_UPPER@", name.upper())
            (place / "msg" / template.stem).write_text(header)
        arguments = {
            "package_name": name,
            "output_dir": str(place),
            "template_dir": str(templates),
            "idl_tuples": [f"{shared}:{idl}" for idl in idls],
            "type_description_tuples": [f"{idl}:{shared / idl[:-4]}.json" for idl in idls],
            "ros_interface_files": [str(path) for path in definitions],
            "include_paths": [f"{it}:{prefix / 'share' / it}" for it in others if it != name],
            "target_dependencies": [],
        }
        file = sources / "arguments.json"
        file.write_text(json.dumps(arguments))
        getattr(importlib.import_module(generator), function)(str(file), *more)

    sources.mkdir(exist_ok=True)
    run("rosidl_generator_type_description", "generate_type_hash", shared)
    run("rosidl_generator_c", "generate_c", sources / "rosidl_generator_c" / name)
    functions = ("generate_typesupport_fastrtps_c", "generate_c")
    for support, function in zip(SUPPORTS, functions, strict=True):
        run(support, function, sources / support / name)
    run(DISPATCH, "generate_c", sources / DISPATCH / name, SUPPORTS)
    run("rosidl_generator_py", "generate_py", wheel / name, [DISPATCH, *SUPPORTS])
    (wheel / name / "__init__.py").touch()
    listed = [f"{path.parent.name}/{path.name}" for path in definitions]
    for resource, text in (("packages", ""), ("rosidl_interfaces", "\n".join([*idls, *listed]))):
        (index / resource).mkdir(parents=True, exist_ok=True)
        (index / resource / name).write_text(text)


def compile_libraries(name: str, sources: Path, wheel: Path) -> None:
    """Compile the libraries of a package and the modules through which Python loads them."""
    import numpy

    prefix, lib, python = wheels_prefix(), wheel / DATA / "lib", wheel / name
    lib.mkdir(exist_ok=True)
    paths = [*sources.glob("rosidl_*/"), prefix / "include", *(prefix / "include").iterdir()]
    paths += [sysconfig.get_path("include"), numpy.get_include()]
    own = f"lib{name}__"  # an earlier version of it may be installed
    installed = [it for it in (prefix / "lib").glob("lib*.so") if not it.name.startswith(own)]

    def compiled(target: Path, files: list[Path]) -> None:
        words = ["-shared", "-fPIC", "-O1", "-s", "-w", *(f"-I{it}" for it in paths)]
        words += [f"-Wl,-soname,{target.name}", "-o", str(target), *map(str, files)]
        words += ["-Wl,--as-needed", *map(str, [*lib.glob(f"{own}*.so"), *installed])]
        file = sources / "words"  # too many to be read in an error
        file.write_text(shlex.join(words))
        subprocess.run(["g++" if files[0].suffix == ".cpp" else "gcc", f"@{file}"], check=True)

    for library in LIBRARIES:
        code = python if library == "rosidl_generator_py" else sources / library / name
        files = [path for path in code.rglob("*.c*") if ".ep." not in path.name]
        compiled(lib / f"{own}{library}.so", files)
    for support in (DISPATCH, *SUPPORTS):
        compiled(python / f"{name}_s__{support}.so", [python / f"_{name}_s.ep.{support}.c"])


def pack(folder: Path, wheel: Path) -> str:
    """Pack a folder into a wheel, without the sources in C; returns the name of the wheel."""
    record = f"{INFO}/RECORD,,\n"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_dir() or path.suffix in (".c", ".pyc"):
                continue
            content, place = path.read_bytes(), path.relative_to(folder).as_posix()
            digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode()
            record += f"{place},sha256={digest.rstrip('=')},{len(content)}\n"
            archive.writestr(place, content)
        archive.writestr(f"{INFO}/RECORD", record)
    return wheel.name
