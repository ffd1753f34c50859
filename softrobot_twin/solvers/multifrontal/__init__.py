"""Multifrontal Cholesky factorization in 3×3 blocks, from the symbolic analysis to the kernels.

Eliminating a node changes only its neighbours. So a sparse factorization is a tree of small dense
ones, the *fronts*: each takes the matrix's entries of the nodes it eliminates, adds what its
children left, eliminates, and leaves the rest to its parent (Duff and Reid 1983; Liu
1992). The tree depends only on the mesh and is found once; a step's time is spent in the fronts.

Read in this order:

    symbolic                 elimination tree, supernodes, and which are merged into one front
    ordering                 which node is eliminated when
    memory_layout            where everything lies in memory
    vector_code              vector instructions from within numba
    dense_kernels            the products C - A Bᵀ, triangles and copies, in registers
    numeric_factorization    the factorization of one front, and of the tree
    condensation             Y = L⁻¹Hᵀ, y = L⁻¹b, W = YᵀY, and back
    cholesky                 all of it behind `Factorization`

Words: a *bar* is three or six columns, a *strip* eight rows (a cache line), a *tile* the part of a
bar that stays in registers, a *run* contiguous rows of an update, a *tree* one connected body.
"""

from softrobot_twin.solvers.multifrontal.cholesky import Multifrontal

__all__ = ["Multifrontal"]
