"""Rows of H and values of δ: what pulls, what is watched, what is measured."""
