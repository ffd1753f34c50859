"""The package: its metadata, its declared dependencies, and its colcon build."""

import ast
import configparser
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from softrobot_twin.command_line.commands import NODES
from softrobot_twin.ros import process
from test.places import PACKAGE, ROOT

# Distributions whose names differ from the modules that they install.
DISTRIBUTIONS = {"PIL": "pillow", "mpl_toolkits": "matplotlib", "pydantic_core": "pydantic",
                 "rerun": "rerun-sdk", "yaml": "pyyaml"}
# Files that a build must not use.
LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv*", ".pytest_cache", "__pycache__", "build", "install", "log", "out")


@pytest.fixture(scope="module")
def metadata(tmp_path_factory):
    """Metadata and entry points of setup.py, as written by setuptools."""
    folder = tmp_path_factory.mktemp("metadata")
    subprocess.run([sys.executable, "setup.py", "-q", "egg_info", "--egg-base", folder],
                   cwd=ROOT, check=True)
    return folder / "softrobot_twin.egg-info"


@pytest.fixture(scope="module")
def manifest():
    return ET.parse(ROOT / "package.xml").getroot()


def requirements(metadata: Path) -> dict[str, str]:
    """Specifier of each distribution that setup.py requires, including extras."""
    lines = (metadata / "requires.txt").read_text().splitlines()
    return dict(re.fullmatch(r"([\w-]+)(.*)", line).groups()
                for line in lines if line and not line.startswith("["))


def test_package_xml_and_setup_py_agree(metadata, manifest):
    told = dict(line.split(": ", 1) for line in (metadata / "PKG-INFO").read_text().splitlines()
                if ": " in line)
    maintainer = manifest.find("maintainer")
    assert told["Name"] == manifest.findtext("name")
    assert told["Version"] == manifest.findtext("version")
    assert told["License"] == manifest.findtext("license") == "Apache-2.0"
    assert told["Maintainer"] == maintainer.text
    assert told["Maintainer-email"] == maintainer.get("email")


def test_the_installation_of_the_readme_has_what_its_example_needs(metadata):
    sections = (metadata / "requires.txt").read_text().split("[")
    study = next(section for section in sections if section.startswith("study]"))
    assert "pandas" in study and "matplotlib" in study
    assert "pip install '.[study]'" in (ROOT / "README.md").read_text()


def test_citation_manifest_setup_and_changelog_name_the_same_version(metadata, manifest):
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    version = manifest.findtext("version")
    assert citation["version"] == version and citation["license"] == "Apache-2.0"
    assert citation["references"][0]["doi"] == "10.1080/01691864.2017.1395362"
    assert f"\nVersion: {version}\n" in (metadata / "PKG-INFO").read_text()
    newest = re.search(r"^## (\S+), (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest[1] == version
    # A release has a date, and then the citation has the same one.
    assert str(citation.get("date-released", "unreleased")) == newest[2]


def test_colcon_takes_the_manifest_without_a_warning():
    package = pytest.importorskip("catkin_pkg.package")
    warnings = []
    parsed = package.parse_package(str(ROOT), warnings=warnings)
    assert warnings == []
    assert parsed.get_build_type() == "ament_python"


def test_every_executable_has_a_main(metadata):
    points = configparser.ConfigParser()
    points.read(metadata / "entry_points.txt")
    # pip puts no node on the PATH under a name as common as "target".
    assert dict(points["console_scripts"]) == {"softrobot_twin": "softrobot_twin.__main__:main"}
    assert callable(import_module("softrobot_twin.__main__").main)
    assert all(callable(getattr(process, node)) for node in NODES)


def test_every_folder_with_modules_is_installed():
    folders = {path.parent for path in PACKAGE.rglob("*.py")}
    assert [str(folder) for folder in folders if not (folder / "__init__.py").is_file()] == []


@pytest.mark.libraries
def test_every_library_that_is_imported_is_declared(metadata, manifest):
    declared = {entry.text for entry in manifest.findall("exec_depend")} | set(
        requirements(metadata))
    libraries = {DISTRIBUTIONS.get(name, name) for name in imported_libraries()}
    assert libraries - declared == set()


def imported_libraries() -> set[str]:
    """Top-level names of the libraries, not Python's own or ours, that the package imports."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"softrobot_twin"}


def test_each_lower_bound_is_the_version_tested(metadata):
    lines = (ROOT / "requirements" / "oldest.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line)
    for name, specifier in requirements(metadata).items():
        bound = re.search(r">=([\d.]+)", specifier)
        if name in pinned:
            assert f"{pinned[name]}.".startswith(f"{bound[1]}."), name
    assert {"numpy", "scipy", "rerun-sdk"} <= set(pinned) <= set(requirements(metadata))


@pytest.mark.exhaustive
@pytest.mark.timeout(900)
def test_colcon_builds_a_twin_that_starts_from_its_share_folder(tmp_path, ros_domain_id):
    source, install = tmp_path / "source", tmp_path / "install"
    shutil.copytree(ROOT, source, ignore=LEFT_OUT)
    build = [sys.executable, "-m", "colcon", "--log-base", tmp_path / "log", "build",
             "--base-paths", source, "--build-base", tmp_path / "build",
             "--install-base", install]
    built = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    # The commands below must not use the sources.
    shutil.rmtree(source)

    prefix = install / "softrobot_twin"
    log = run_until_ready(
        ["bash", "-c", f'. "{install}/setup.bash" && exec "$@"', "start",
         prefix / "lib/softrobot_twin/twin", "--ros-args",
         "--params-file", prefix / "share/softrobot_twin/config/diamond.yaml"],
        {**os.environ, "ROS_DOMAIN_ID": str(ros_domain_id)}, tmp_path)
    assert str(prefix / "share/softrobot_twin/config/scenes") in log


def run_until_ready(command: list, environment: dict[str, str], folder: Path) -> str:
    """Starts a node, waits for its "ready", interrupts it, and gives what it said."""
    path = folder / "node.log"
    with path.open("w") as stream:
        node = subprocess.Popen(command, env=environment, cwd=folder, stdout=stream,
                                stderr=subprocess.STDOUT, start_new_session=True)
    try:
        # It compiles the kernels of a twin that no test has used yet, perhaps on a busy machine.
        deadline = time.monotonic() + 600
        while "ready" not in path.read_text():
            assert node.poll() is None, path.read_text()
            assert time.monotonic() < deadline, path.read_text()
            time.sleep(0.1)
        os.killpg(node.pid, signal.SIGINT)
        assert node.wait(30) == 0, path.read_text()
    finally:
        if node.poll() is None:
            node.kill()
            node.wait()
    return path.read_text()


# What other libraries show only by such a name: numba's overloads, named tuples, pages of a notebook.
SHOWN = {"_overload_func", "_replace", "_fields", "_ipython_display_", "_exit"}


def test_no_test_uses_a_private_name():
    found = {str(path.relative_to(ROOT)): names for path in (ROOT / "test").rglob("*.py")
             if (names := private_names(ast.parse(path.read_text())) - SHOWN)}
    assert found == {}


def private_names(tree: ast.AST) -> set[str]:
    """Names with an underscore before that a file uses, and that its own classes do not have."""
    used, own = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            own.add(node.name)
        elif isinstance(node, ast.Attribute):
            is_set = isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self"
            (own if is_set else used).add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            used |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr"):
            used |= {part.value for part in node.args[1:2] if isinstance(part, ast.Constant)}
    return {name for name in used - own if re.match("_[^_]", str(name))}
