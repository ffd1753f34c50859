"""Compiled kernels: options, machine code on disk and ahead of time, traced stages, threads."""
