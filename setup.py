# SPDX-License-Identifier: Apache-2.0
"""Installation of the package, for pip and for colcon (ament_python)."""

import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "pam_orthosis"
NODES = [
    "plant_simulator",
    "trajectory_publisher",
    "position_controller",
    "pressure_controller",
    "extensor_pressure_controller",
    "flexor_pressure_controller",
    "inverse_valve_model",
    "safety_monitor",
    "bag_recorder",
    "dummy_driver",
    "leg_state_publisher",
    "live_view",
]
EXECUTABLES = [*NODES, "pam-orthosis"]
# `ros2 run` looks into lib/PACKAGE: colcon installs the entry points there, pip installs them into bin/
# and needs a relay to each
RELAYS = [f"scripts/{name}" for name in EXECUTABLES] if "bdist_wheel" in sys.argv else []
ROS = [
    "ros-jazzy-rclpy[fastrtps]==7.1.6; sys_platform == 'linux' and platform_machine == 'x86_64'",
    "ros-jazzy-common-interfaces; sys_platform == 'linux' and platform_machine == 'x86_64'",
]
CLUSTER = ["distributed>=2024.1"]
DOCS = ["mkdocs>=1.6", "mkdocs-material>=9.5", "mkdocstrings-python>=1.10"]
NOTEBOOKS = ["ipykernel>=6.29", "nbclient>=0.10", "nbformat>=5.9"]
PANDAS = ["pandas>=2.0"]
MODBUS = ["pymodbus>=3.16"]
HIDE = ["numba>=0.59"]
TEST = [
    *CLUSTER,
    *DOCS,
    *HIDE,
    *MODBUS,
    *NOTEBOOKS,
    *PANDAS,
    "catkin_pkg>=1.0",
    "colcon-common-extensions>=0.3",
    "hypothesis>=6",
    "import-linter>=2.15",
    "mcap-ros2-support>=0.5",
    "mypy>=1.15",
    "playwright>=1.40",
    "ament-lint-pep257>=0.14",
    "flake8>=6",
    "pydocstyle>=6",
    "pytest>=7",
    "pytest-xdist>=3",
    "ros-ament-flake8>=0.19",
    "ruff>=0.5",
    "urdf-parser-py>=0.0.4",
    "wheel>=0.40",
]

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Emulated knee orthosis with two antagonistic fluidic muscles, as ROS 2 nodes",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    license_files=["LICENSE"],
    python_requires=">=3.10",
    packages=[*find_packages(exclude=["test", "test.*"]), "pam_orthosis.config", "pam_orthosis.examples"],
    package_dir={"pam_orthosis.config": "config", "pam_orthosis.examples": "bags"},
    package_data={
        "pam_orthosis.config": ["*.json", "*.py", "*.xml", "*.yaml", "machines/*.yaml", "devices/*.yaml"],
        "pam_orthosis.report": ["assets/*", "templates/*.html"],
        "pam_orthosis.examples": ["*.npz", "*/metadata.yaml", "*/*.mcap"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml", "LICENSE", "QUALITY_DECLARATION.md"]),
        (f"share/{PACKAGE}/config", glob("config/*.*")),
        (f"share/{PACKAGE}/launch", glob("launch/*.launch.xml")),
        (f"share/{PACKAGE}/config/machines", glob("config/machines/*.yaml")),
        (f"share/{PACKAGE}/config/devices", glob("config/devices/*.yaml")),
        (f"lib/{PACKAGE}", RELAYS),
    ],
    install_requires=[
        "apsw>=3.40",
        "casadi>=3.6",
        "jinja2>=3.1",
        "lz4>=4.0",
        "markupsafe>=2.1",
        "matplotlib>=3.7",
        "mcap>=1.6",
        "numpy>=1.24",
        "pillow>=9.0",
        "pyyaml>=6.0",
        "rosbags>=0.11.6,<0.12",  # bag/bounded.py puts bounds into its readers
        "scipy>=1.10",
        "shtab>=1.7",
        "threadpoolctl>=3.1",
        "zstandard>=0.20",
    ],
    extras_require={
        "bench": ["mujoco>=3.1"],
        "cluster": CLUSTER,
        "docs": DOCS,
        "hide": HIDE,
        "pandas": PANDAS,
        "modbus": MODBUS,
        "notebooks": NOTEBOOKS,
        "peer": ["pysindy>=2.0"],
        "ros": ROS,
        "test": TEST,
    },
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "pam-orthosis = pam_orthosis.cli.main:main",
            *[f"{node} = pam_orthosis.nodes.entry:{node}" for node in NODES],
        ]
    },
)
