"""The archives of a release: what is in them, and that an installation of the wheel is enough."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import warnings
from pathlib import Path

import pytest

from test.places import ROOT

# Files that a build must not use.
LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv*", ".pytest_cache", "__pycache__", "build", "dist", "*.egg-info", "install",
    "log", "out")
README = (ROOT / "README.md").read_text(encoding="utf-8")
CODE = README.partition("```python\n")[2].partition("```")[0]
TELL_PLACES = "\nprint(st.__file__)\nprint(finger.scene.path)\n"
# What another environment offers is not to be found.
OWN = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
# What pip says where no index answers.
NO_INDEX = ("NewConnectionError", "ConnectTimeoutError", "ReadTimeoutError", "ProxyError")


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The folder of the source archive and of the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("release")
    shutil.copytree(ROOT, folder / "clone", ignore=LEFT_OUT)
    # As `make dist` does, for one robot.
    for command in (["tools/compile_kernels.py", "--ship", "finger"],
                    ["-m", "build", "--no-isolation", "--outdir", folder / "dist"]):
        built = subprocess.run(
            [sys.executable, *command], cwd=folder / "clone", capture_output=True, text=True,
            env=os.environ | {"PYTHONPATH": str(folder / "clone")})
        assert built.returncode == 0, built.stdout + built.stderr
    shutil.rmtree(folder / "clone")
    return folder / "dist"


@pytest.mark.exhaustive
def test_the_source_archive_has_every_file_of_the_repository(archives):
    asked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if asked.returncode:
        pytest.skip("these sources are no clone")
    (archive,) = archives.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        found = {name.partition("/")[2] for name in opened.getnames()}
    missing = {name for name in asked.stdout.split("\0") if name and (ROOT / name).is_file()} - found
    assert missing == set()


@pytest.mark.exhaustive
@pytest.mark.timeout(900)
def test_the_readmes_python_compiles_nothing_in_any_folder_where_only_the_wheel_is_installed(
        archives, tmp_path):  # fmt: skip
    (wheel,) = archives.glob("*.whl")
    environment = tmp_path / "environment"
    venv.create(environment, symlinks=True)
    python = environment / "bin" / "python"
    install(f"{wheel}[study]", wheel, python)
    (tmp_path / "elsewhere").mkdir()
    ran = subprocess.run(
        [python, "-c", CODE + TELL_PLACES], cwd=tmp_path / "elsewhere", capture_output=True,
        text=True, env={**OWN, "MPLBACKEND": "agg", "NUMBA_CACHE_DIR": str(tmp_path / "kernels")})
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "Status.OK" in ran.stdout
    assert not list((tmp_path / "kernels").glob("*.nbc"))
    package, scene = map(Path, ran.stdout.split()[-2:])
    assert environment in package.parents
    assert scene == environment / "share/softrobot_twin/config/scenes/finger.yaml"
    assert (tmp_path / "elsewhere" / "finger.png").stat().st_size > 10_000


def install(what: str, wheel: Path, python: Path) -> None:
    """Installs the wheel and its libraries; without an index the libraries of this environment."""
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check",
           "install", "--quiet", "--retries", "1"]
    done = subprocess.run([*pip, what], capture_output=True, text=True, env=OWN)
    if done.returncode == 0:
        return
    assert any(word in done.stderr for word in NO_INDEX), done.stderr
    warnings.warn("pip reaches no index: the wheel uses the libraries of this environment",
                  stacklevel=2)
    subprocess.run([*pip, "--no-deps", "--no-index", wheel], check=True, env=OWN)
    # A folder that is named so is searched last, and its own .pth files, such as those of an
    # editable installation, are not read.
    folder = next((python.parents[1] / "lib").glob("python*/site-packages"))
    (folder / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
