"""Installs pip into the running environment, for a Python without ensurepip."""

import hashlib
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

PACKAGES = "https://files.pythonhosted.org/packages"
WHEEL = "pip-25.3-py3-none-any.whl"
URL = f"{PACKAGES}/44/3c/d717024885424591d5376220b5e836c2d5293ce2011523c9de23ff7bf068/{WHEEL}"
SHA256 = "9655943313a94722b7774661c21049070f6bbb0a1516bf02f7c8d5d9201514cd"


def main() -> None:
    try:
        with urllib.request.urlopen(URL, timeout=60) as answer:
            content = answer.read()
    except OSError as error:
        sys.exit(f"Python has no ensurepip and pip cannot be fetched ({error}): "
                 "install it with 'sudo apt install python3.12-venv'.")
    if hashlib.sha256(content).hexdigest() != SHA256:
        sys.exit(f"{URL} is not the file that was expected: "
                 "install pip with 'sudo apt install python3.12-venv'.")
    with tempfile.TemporaryDirectory() as folder:
        wheel = Path(folder, WHEEL)
        wheel.write_bytes(content)
        # pip can be run from inside its own wheel.
        subprocess.run([sys.executable, f"{wheel}/pip", "install", "--quiet", "--no-index", wheel],
                       check=True)


if __name__ == "__main__":
    main()
