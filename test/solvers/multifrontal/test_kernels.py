"""The small kernels against plain numpy."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest



RNG = np.random.default_rng(0)


def columns(rows, count):
    """A random matrix that is stored by columns."""
    return np.asfortranarray(RNG.standard_normal((rows, count)))


SYSTEM = """
import sys
import numpy as np
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal.vector_code import VECTOR_WIDTH
# The analysis counts and sorts, without vectors: as Python it needs no compilation.
for module in [module for name, module in sys.modules.items() if ".multifrontal." in name]:
    for name, kernel in list(vars(module).items()):
        if hasattr(kernel, "py_func") and kernel.__module__.endswith(".symbolic"):
            setattr(module, name, kernel.py_func)
rng = np.random.default_rng(0)
n = 60
rows, columns = rng.integers(0, n, (2, 150))
solver = Multifrontal(rows, columns, n)
A = 40.0 * np.eye(3 * n).reshape(n, 3, n, 3)
for r, c in zip(rows, columns):
    if r != c:
        A[r, :, c] = rng.uniform(-1, 1, (3, 3))
        A[c, :, r] = A[r, :, c].T
r = np.concatenate([rows, columns, np.arange(n)])
c = np.concatenate([columns, rows, np.arange(n)])
lower = solver.elimination_rank[r] >= solver.elimination_rank[c]
r, c = r[lower], c[lower]
offsets, strides = solver.slots(r, c)
for i in range(3):
    for j in range(3):
        solver.storage[offsets + i + j * strides] = A[r, i, c, j]
A = A.reshape(3 * n, 3 * n)
assert solver.factor()
H = NodeRows(np.arange(9), np.arange(9) * 5, rng.standard_normal((9, 3)), 9)
b = rng.standard_normal((n, 3))
W, free = solver.condense(H, b)
dense = H.transposed(n)
np.testing.assert_allclose(W, dense.T @ np.linalg.solve(A, dense), atol=1e-13)
dx = solver.expand(np.ones(9)).ravel()
np.testing.assert_allclose(A @ dx, b.ravel() + dense.sum(axis=1), atol=1e-11)
print(VECTOR_WIDTH)
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("processor, features, lanes", [
    ("haswell", "+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma", 4),
    ("x86-64", "+sse,+sse2", 2),
])  # fmt: skip
def test_processors_with_shorter_vectors_compute_the_same(processor, features, lanes):
    if os.uname().machine != "x86_64":
        pytest.skip("names processors of x86_64")
    environment = os.environ | {
        "NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": features,
        "PYTHONPATH": str(Path(__file__).parents[3]),
    }  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", SYSTEM], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) == lanes
