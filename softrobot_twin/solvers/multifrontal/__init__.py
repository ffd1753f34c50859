"""Multifrontal Cholesky factorization in 3×3 blocks, from the symbolic analysis to the kernels.

Eliminating a node changes only its neighbours. So a sparse factorization is a tree of small dense
ones, the *fronts*: each takes the matrix's entries of the nodes it eliminates, adds what its
children left, eliminates, and leaves the rest to its parent (Duff & Reid 1983; Liu, "The
multifrontal method for sparse matrix solution", SIAM Review 34, 1992). The tree depends on the
mesh only and is found once; the fronts are where a step's time goes.

Read in this order:

    ordering, nested_dissection      which node is eliminated when
    elimination_tree, symbolic       what that couples; nodes grouped into fronts
    merging                          which fronts are worth joining
    layout, reused_memory            where everything lies in memory
    vector_code, tiles               the product C - A Bᵀ, in registers
    triangles, moves, column_products  the small kernels
    dense_front, numeric             the factorization of one front, and of the tree
    row_lanes                        where the rows of H go in Y
    solves, lane_products            Y = L⁻¹Hᵀ, y = L⁻¹b, W = YᵀY, and back
    reach                            which fronts rows reach, for counting operations
    cholesky                         all of it behind `Factorization`
"""

from softrobot_twin.solvers.multifrontal.cholesky import Multifrontal

__all__ = ["Multifrontal"]
