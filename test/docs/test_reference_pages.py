"""The generated parts of docs/ are what the sources say."""

import os
import subprocess
import sys

import write_reference

from test.places import ROOT


TOOL = ROOT / "tools" / "write_reference.py"


def test_the_pages_are_what_the_sources_say():
    # In a process of its own: without laws and sections that other tests registered.
    done = subprocess.run([sys.executable, TOOL, "--check"], capture_output=True, text=True,
                          env=os.environ | {"COLUMNS": "30"}, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
