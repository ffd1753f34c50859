"""Kernels, BLAS and numpy are told a level of instructions, so that machines of one kind agree."""

import os
import subprocess
import sys

import pytest

from softrobot_twin.kernels import instruction_set

V2 = "cx16 lahf_lm popcnt sse4_1 sse4_2 ssse3"
SANDY_BRIDGE = f"{V2} avx"
HASWELL = f"{SANDY_BRIDGE} avx2 bmi1 bmi2 f16c fma abm movbe"
SKYLAKE = f"{HASWELL} avx512f avx512bw avx512cd avx512dq avx512vl"
VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "OPENBLAS_CORETYPE",
             "NPY_DISABLE_CPU_FEATURES")  # fmt: skip
# A process on another processor: what the system and LLVM say of it. A run of it, as digest.
RUN = """
import io, pathlib, sys
from llvmlite import binding
real, flags, name = pathlib.Path.open, sys.argv[1], sys.argv[2]
pathlib.Path.open = lambda path, *arguments, **options: (
    io.StringIO(f"flags : {flags}\\n") if str(path) == "/proc/cpuinfo"
    else real(path, *arguments, **options))
features = binding.get_host_cpu_features()
binding.get_host_cpu_name = lambda: name
binding.get_host_cpu_features = lambda: type(features)(
    {each: has and ("avx512" in flags or "avx512" not in each) for each, has in features.items()})
import softrobot_twin as st
from hashlib import sha256
from numba.core.registry import cpu_target
from softrobot_twin.kernels.blas_threads import loaded_blas_core
robot, digest = st.load("config/scenes/diamond.yaml"), sha256()
for number in range(5):
    digest.update(robot.step(st.targets(tip=[0.002 * number, 0.0, 0.1])).positions.tobytes())
    import numpy as np
    digest.update(np.exp(np.linspace(-3.0, 3.0, 1000)).tobytes())
print(digest.hexdigest(), cpu_target.target_context.codegen().magic_tuple()[1:],
      loaded_blas_core())
"""


def chosen(monkeypatch, tmp_path, flags: str, machine: str = "x86_64") -> dict[str, str]:
    (tmp_path / "cpuinfo").write_text(f"processor : 0\nflags : {flags}\nprocessor : 1\nflags : x\n")
    monkeypatch.setattr(instruction_set, "PROCESSOR", tmp_path / "cpuinfo")
    monkeypatch.setattr(instruction_set.platform, "machine", lambda: machine)
    monkeypatch.delitem(sys.modules, "numpy", raising=False)
    environment = {}
    instruction_set.choose_level(environment)
    return environment


@pytest.mark.parametrize("flags, name, core", [
    (SKYLAKE, "x86-64-v3", "Sandybridge"), (HASWELL, "x86-64-v3", "Sandybridge"),
    (SANDY_BRIDGE, "x86-64-v2", "Nehalem"), (V2, "x86-64-v2", "Nehalem"),
    ("sse2", "x86-64", "Prescott"),
])  # fmt: skip
def test_processors_of_one_kind_have_one_level(monkeypatch, tmp_path, flags, name, core):
    found = chosen(monkeypatch, tmp_path, flags)
    assert (found["NUMBA_CPU_NAME"], found["OPENBLAS_CORETYPE"]) == (name, core)
    # numpy warns where it is told to leave out what the processor has not.
    assert bool(found["NPY_DISABLE_CPU_FEATURES"]) is (flags is SKYLAKE)


DENSE = """
import softrobot_twin
import numpy as np
for n in (64, 200, 630):
    for count in range(1, 12):
        A = np.random.default_rng(count).standard_normal((n, n))
        np.linalg.solve(A @ A.T + n * np.eye(n), A[:, :count])
print("done")
"""


def test_dense_products_and_solves_end():
    assert run(DENSE).split() == ["done"]


def test_aarch64_has_its_baseline_and_other_machines_are_left_to_themselves(monkeypatch, tmp_path):
    found = chosen(monkeypatch, tmp_path, "", "aarch64")
    assert (found["NUMBA_CPU_NAME"], found["OPENBLAS_CORETYPE"]) == ("generic", "ARMV8")
    assert not chosen(monkeypatch, tmp_path, "", "riscv64").keys() & set(VARIABLES)


def test_a_processor_that_the_user_names_is_kept():
    for name in VARIABLES:
        environment = {name: "of the user"}
        instruction_set.choose_level(environment)
        assert environment[name] == "of the user"
    environment = {"NUMBA_CPU_NAME": "generic"}
    instruction_set.choose_level(environment)
    assert "NUMBA_CPU_FEATURES" not in environment


def test_where_numpy_is_there_already_other_processes_do_as_this_one():
    code = ("import numpy, os, sys; import softrobot_twin; from softrobot_twin.kernels.blas_threads import "
            "loaded_blas_core; print(loaded_blas_core() == os.environ['OPENBLAS_CORETYPE'], "
            "os.environ['NPY_DISABLE_CPU_FEATURES'] == '')")  # fmt: skip
    assert run(code).split() == ["True", "True"]


def run(code: str, *arguments: str, **variables: str) -> str:
    """What a process prints that inherits none of the variables that tell a level."""
    kept = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run([sys.executable, "-c", code, *arguments], env=kept | variables,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.exhaustive
def test_a_run_gives_the_same_bits_on_two_other_processors():
    level, flags = instruction_set.level_of_machine()
    if level is None or level.name != "x86-64-v3":
        pytest.skip("this machine has not the instructions of the others")
    # On the older one numpy has no AVX-512 to choose, on the newer one it is told not to.
    older = run(RUN, HASWELL, "haswell", NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512F AVX512_SKX")
    newer = run(RUN, SKYLAKE if "avx512f" in flags else HASWELL, "skylake-avx512")
    assert older == newer and "x86-64-v3" in newer and "Sandybridge" in newer
