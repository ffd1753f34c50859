"""How fast this machine multiplies dense matrices: the speed no factorization can pass."""

from __future__ import annotations

from time import perf_counter

import numpy as np

_SIZE = 512


class DenseSpeed:
    """Times products of two square matrices in double precision."""

    def __init__(self) -> None:
        generator = np.random.default_rng(1)
        self._a, self._b = generator.standard_normal((2, _SIZE, _SIZE))
        self._c = np.empty((_SIZE, _SIZE))

    def measure(self) -> float:
        """Speed of one product, after another one that fills the caches [flop/s]."""
        np.matmul(self._a, self._b, out=self._c)
        start = perf_counter()
        np.matmul(self._a, self._b, out=self._c)
        return 2.0 * _SIZE**3 / (perf_counter() - start)
