"""Prints what the package requires, and what the extras that are named do, a line each.

Run it in the top folder with a Python that has setuptools.
"""

import sys

import setuptools  # noqa: F401  brings distutils, which Python 3.12 has no longer
from distutils.core import run_setup

package = run_setup("setup.py", stop_after="init")
for extra in sys.argv[1:]:
    if extra not in package.extras_require:
        sys.exit(f"setup.py has no extra {extra!r}")
print(*package.install_requires, sep="\n")
for extra in sys.argv[1:]:
    print(*package.extras_require[extra], sep="\n")
