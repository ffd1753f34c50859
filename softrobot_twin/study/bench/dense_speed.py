"""How fast this machine multiplies dense matrices: the speed no factorization can pass."""

from __future__ import annotations

from time import thread_time

import numpy as np

_SIZE = 512


class DenseSpeed:
    """Times products of two square matrices in double precision."""

    def __init__(self) -> None:
        generator = np.random.default_rng(1)
        self._a, self._b = generator.standard_normal((2, _SIZE, _SIZE))
        self._c = np.empty((_SIZE, _SIZE))

    def measure(self) -> float:
        """Speed of one product, after another one that fills the caches [flop/s].

        By processor time: what other processes take is left out.
        """
        np.matmul(self._a, self._b, out=self._c)
        start = thread_time()
        np.matmul(self._a, self._b, out=self._c)
        return 2.0 * _SIZE**3 / (thread_time() - start)
