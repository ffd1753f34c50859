"""Factorizations and QP solvers side by side, in time and in accuracy."""
