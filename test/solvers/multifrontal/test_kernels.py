"""Kernels of other widths of vectors: what is condensed by them is what dense algebra gives."""

import os
import subprocess
import sys

import pytest

from test.places import ROOT

ANSWERS = [f"test/solvers/multifrontal/test_cholesky.py::test_{name}" for name in (
    "condensing_gives_the_dense_compliance", "expanding_solves_for_the_forces_of_the_constraints")]
WIDTH = "from softrobot_twin.solvers.multifrontal.vector_code import VECTOR_WIDTH; print(VECTOR_WIDTH)"


@pytest.mark.exhaustive
@pytest.mark.parametrize("processor, features, lanes", [
    ("haswell", "+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma", 4),
    ("x86-64", "+sse,+sse2", 2),
])  # fmt: skip
def test_processors_with_shorter_vectors_compute_the_same(processor, features, lanes):
    if os.uname().machine != "x86_64":
        pytest.skip("names processors of x86_64")
    environment = os.environ | {
        "NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": features, "PYTHONPATH": str(ROOT)}
    for arguments in (["-c", WIDTH], ["-m", "pytest", "-q", *ANSWERS]):
        run = subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment,
                             capture_output=True, text=True)
        assert run.returncode == 0, run.stdout + run.stderr
        assert arguments[0] == "-m" or int(run.stdout) == lanes
