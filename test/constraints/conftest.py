"""Fixtures of the tests of constraint terms: terms bound to a matrix, and their rows."""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU
from test.builder import builder


@builder
def bound_term(kind, entries, rest, fixed=()):
    """Binds a term of free nodes; gives it, the matrix it adds to, and the free nodes."""
    free_index = np.full(len(rest), -1)
    free = np.setdiff1d(np.arange(len(rest)), fixed)
    free_index[free] = np.arange(len(free))
    term = kind(entries, free_index, rest)
    matrix = SuperLU(*stencil_pairs(term.stencils()), len(free))
    term.bind(matrix.elimination_rank, matrix.slots)
    return term, matrix, free


@builder
def dense_rows(term, x, free):
    """H of a term at a state, dense, and δ."""
    blocks, values = np.full((len(term.entry_rows), 3), np.nan), np.full(term.row_count, np.nan)
    term.evaluate(x, blocks, values)
    H = np.zeros((term.row_count, len(free), 3))
    np.add.at(H, (term.entry_rows, term.entry_nodes), blocks)
    return H, values
