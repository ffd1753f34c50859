"""Arrays in, arrays out: A⁻¹, the Schur complement W, and the small problems posed on it."""

from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import SuperLU

FACTORIZATIONS = {"multifrontal": Multifrontal, "superlu": SuperLU}
"""Factorizations by the names that scenes give them (``solver.factorization``)."""
