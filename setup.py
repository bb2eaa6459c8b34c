# SPDX-License-Identifier: Apache-2.0
"""Package definition for both `colcon build` (ament_python) and `pip install -e .`."""

import os
import sys
from pathlib import Path

from setuptools import Extension, find_packages, setup

NAME = "wam_power_ros"
HERE = Path(__file__).resolve().parent  # colcon build --symlink-install runs a link to this file


def requirements() -> dict[str, list[str]]:
    """Sections of requirements.txt: `# [name]: ...` and the lines below it."""
    sections: dict[str, list[str]] = {}
    for line in (HERE / "requirements.txt").read_text().splitlines():
        if line.startswith("# ["):
            current = sections.setdefault(line[3 : line.index("]")], [])
        elif line and not line.startswith("#"):
            current.append(line)
    return sections


def shared(*folders: str) -> list[tuple[str, list[str]]]:
    """Files of these folders, installed to the same places under share/wam_power_ros."""
    files = [path for folder in folders for path in sorted((HERE / folder).rglob("*"))]
    places: dict[str, list[str]] = {}
    for path in files:
        if path.is_file() and "__pycache__" not in path.parts and path.name[0] != ".":
            place = path.relative_to(HERE)
            places.setdefault(f"share/{NAME}/{place.parent}", []).append(str(place))
    return list(places.items())


extras = requirements()
core = [line for line in extras.pop("core") if "ROS_DISTRO" not in os.environ or line[:3] != "pin"]
nodes = [
    f"torque_controller = {NAME}.entry:torque_controller",
    f"demonstration_recorder = {NAME}.entry:demonstration_recorder",
    f"body_tracker = {NAME}.entry:body_tracker",
    f"pancake_tracker = {NAME}.entry:pancake_tracker",
    f"learner = {NAME}.entry:learner",
    f"check_driver = {NAME}.entry:check_driver",
    f"tag_camera = {NAME}.entry:tag_camera",
    f"franka_driver = {NAME}.entry:franka_driver",
    f"natnet_client = {NAME}.entry:natnet_client",
    f"wam_sim = {NAME}.entry:wam_sim",
    f"replay = {NAME}.entry:replay",
]
# colcon and bloom run these commands, and `ros2 run` looks for the executables where setup.cfg puts
# them. pip runs others: it would put a `learner` and a `replay` on everybody's path.
for_ros = {"install", "develop"} & {*sys.argv}

setup(
    name=NAME,
    version="0.1.0",
    description="Teach a robot arm a movement by hand; it improves the movement by trial and error",
    long_description=(HERE / "README.md").read_text(),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    author="The wam_power_ros developers",
    keywords=[
        "robot learning",
        "reinforcement learning",
        "PoWER",
        "dynamic movement primitives",
        "ROS 2",
    ],
    classifiers=[
        "Development Status :: 3 - Alpha",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 14)),
        "Topic :: Scientific/Engineering :: Artificial Intelligence",
    ],
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=[NAME, f"{NAME}.*", "hardware_sim", "hardware_sim.*"]),
    package_data={f"{NAME}.reporting": ["*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared("config", "launch", "urdf", "bags", "security"),
    ],
    # Optional: without a C compiler the Python code beside it does the same. Fused operations would
    # give it other last digits than that code.
    ext_modules=[
        Extension(
            f"{NAME}._kernel",
            [f"{NAME}/_kernel.c"],
            extra_compile_args=["-O2", "-ffp-contract=off"],
            optional=True,
        )
    ],
    install_requires=core,
    extras_require=extras,
    zip_safe=False,
    entry_points={
        "console_scripts": [*(nodes if for_ros else ()), f"wam-power = {NAME}.entry:wam_power"],
        f"{NAME}.nodes": nodes,
        f"{NAME}.scenes": [
            "ball_in_cup = hardware_sim.scenes.ball_in_cup:BallInCup",
            "flip = hardware_sim.scenes.flip:Flip",
            "reach = hardware_sim.scenes.reach:Reach",
            "markers = hardware_sim.scenes.markers:Markers",
        ],
        "wam_power_ros.tasks": [
            f"ball_in_cup = {NAME}.tasks.ball_in_cup.task:BallInCup",
            f"flip = {NAME}.tasks.flip.task:Flip",
            f"rated = {NAME}.tasks.rated:Rated",
            f"reach = {NAME}.tasks.reach.task:Reach",
        ],
        "wam_power_ros.learners": [
            f"power = {NAME}.learning.power:Power",
            f"shaped_power = {NAME}.learning.shaped_power:ShapedPower",
            f"cma_es = {NAME}.learning.cma_es:CmaEs",
            f"corrections_only = {NAME}.learning.corrections_only:CorrectionsOnly",
            f"model_based = {NAME}.learning.model_based:ModelBased",
        ],
    },
)
