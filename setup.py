"""The ament_python package of softrobot_twin; package.xml repeats its run-time dependencies."""

import sys
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "softrobot_twin"
# colcon's `install` and `develop` put scripts where `ros2 run` looks. pip would put these names on the PATH.
NODES = ("device", "target", "twin") if {"install", "develop"} & set(sys.argv) else ()
SHARED_SUFFIXES = {".csv", ".inp", ".msh", ".npz", ".rviz", ".vtk", ".vtu", ".yaml"}


def shared_files(
    folder: str, suffixes: set[str] = SHARED_SUFFIXES
) -> list[tuple[str, list[str]]]:
    """Files of a folder, each under the same relative path below the package's share folder.

    The layout is kept because a scene names its mesh relative to itself.
    """
    files = sorted(path for path in Path(folder).rglob("*") if path.suffix in suffixes)
    return [(f"share/{PACKAGE}/{path.parent}", [str(path)]) for path in files]


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Digital twin and controller of soft robots for ROS 2",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="softrobot_twin maintainers",
    maintainer_email="maintainers@softrobot-twin.example",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files("config"),
        *shared_files("launch", {".py"}),
        *shared_files("meshes"),
    ],
    package_data={PACKAGE: [
        "py.typed", "kernels/kernels.zip", "kernels/kernels_of_scenes.xz", "scene/material_presets.json",
        "study/first_scene.yaml", "conversion/components.yaml", "conversion/prefabs.yaml"]},
    python_requires=">=3.12",
    # Each lower bound is installed and tested: requirements/oldest.txt.
    install_requires=[
        "daqp>=0.11",
        "llvmlite>=0.43",
        "meshio>=5.3.5",
        "numba>=0.60",
        "numpy>=1.26.4",
        "pydantic>=2.7",
        "pyyaml>=6.0.1",
        "rerun-sdk>=0.23.1,<0.42",
        "rich>=13.7.1",
        "scipy>=1.11.4",
        "trimesh>=4.6",
    ],
    extras_require={
        "study": ["matplotlib>=3.8", "pandas>=2.2", "pillow>=8"],
        # Only for `workspace --scheduler`.
        "cluster": ["dask>=2024.2.1", "distributed>=2024.2.1"],
        # Only for comparisons by tools/compare_solvers.py; pypardiso installs the proprietary MKL.
        "compare": ["osqp>=1.0.5", "pypardiso>=0.4.6", "qdldl>=0.1.7"],
        # Builds docs/ as a site: make docs.
        "docs": ["latex2mathml>=3.77", "mkdocs>=1.6", "mkdocs-material>=9.5.24"],
        # The gymnasium environment.
        "learning": ["gymnasium>=1.1", "matplotlib>=3.8"],
        # Meshes from CAD files. gmsh has no wheel for aarch64. manifold3d unites solids: mesh --repair.
        "mesh": ["gmsh>=4.12; platform_machine == 'x86_64'", "manifold3d>=3.1"],
        # The parameter `record` of the twin, and `replay`.
        "record": ["mcap>=1.5"],
        # colcon uses commands that setuptools 80 removed.
        "test": [
            # The archives of a release: make dist.
            "build>=1.2",
            "colcon-common-extensions",
            "ipykernel>=6",
            "mypy>=1.11",
            "nbclient>=0.10",
            "pytest>=8",
            "pytest-timeout>=2.3",
            "pytest-xdist>=3.5",
            "ros-domain-coordinator",
            "setuptools>=70.1,<80",
        ],
    },
    entry_points={
        "console_scripts": [
            f"softrobot_twin = {PACKAGE}.__main__:main",
            *(f"{node} = {PACKAGE}.ros.process:{node}" for node in NODES),
        ],
    },
)
