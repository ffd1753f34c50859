"""Slopes of functions of positions."""

import numpy as np


def central_slopes(function, x, nodes, step):
    """Central differences of a function by each coordinate of some nodes, the last axis."""
    columns = []
    for node in nodes:
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            columns.append((function(ahead) - function(behind)) / (2.0 * step))
    return np.stack(columns, axis=-1)
