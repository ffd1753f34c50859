#!/usr/bin/env bash
# Makes a virtual environment that holds the package, editable, and all it needs:
#     tools/set_up.sh FOLDER PIP_ARGUMENT...
# An environment made from the same requirements is left as it is. Several may be made at once.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$1
shift
python="$folder/bin/python"

refuse() {
    echo "$1" >&2
    exit 1
}

# Prints the base interpreter of the first Python 3.12 on the PATH that can make environments; fails
# where there is none. Ubuntu keeps ensurepip, which puts pip into them, in a package of its own.
find_python() {
    local candidate
    while IFS= read -r candidate; do
        "$candidate" - 2>/dev/null <<'PYTHON' && return
import ensurepip, os, sys, venv
if sys.version_info[:2] != (3, 12):
    sys.exit(1)
print(os.path.realpath(sys.executable))
PYTHON
    done < <(type -ap python3.12 python3)
    return 1
}

check_platform() {
    if [ "${ROS_DISTRO:-jazzy}" != jazzy ]; then
        refuse "ROS 2 '$ROS_DISTRO' is sourced and softrobot_twin needs ROS 2 Jazzy: source\
 /opt/ros/jazzy/setup.bash instead, or start a shell without ROS."
    fi
    if [[ "$*" == *ros-wheels* && "$(uname -m)" != x86_64 ]]; then
        refuse "PyPI has no ROS 2 wheels for $(uname -m): install ROS 2 Jazzy\
 (ros-jazzy-ros-base) and source /opt/ros/jazzy/setup.bash first."
    fi
}

make_environment() {
    local base
    base=$(find_python) || refuse "softrobot_twin needs Python 3.12 with venv on the PATH: install it\
 with 'sudo apt install python3.12-venv' (Ubuntu 24.04), 'pyenv install 3.12' or 'uv python install\
 3.12'."
    echo "Setting up $folder with $("$base" --version), once: about a minute."
    "$base" -m venv --clear "$folder"
}

install_packages() {
    # What a sourced ROS puts on the PYTHONPATH is not pip's to count as installed.
    # It would compile all modules; Python compiles those that are imported, and keeps them.
    local pip=(env -u PYTHONPATH "$python" -m pip --quiet --disable-pip-version-check install
        --no-compile)
    "${pip[@]}" --requirement requirements/build.txt
    env -u PYTHONPATH "$python" tools/print_requirements.py >"$folder/requirements.txt" \
        cluster docs learning mesh record study test
    "${pip[@]}" --requirement "$folder/requirements.txt" "$@"
    # Building the package writes into its folder: one environment after the other.
    exec 8<"$0"
    flock 8
    "${pip[@]}" --use-pep517 --no-build-isolation --no-deps --editable .
    exec 8<&-
    export PYTHONDONTWRITEBYTECODE=
    if [[ "$*" == *ros-wheels* ]]; then
        tools/build_tf2_msgs.sh "$folder"
    fi
    "$python" -c 'import rclpy, diagnostic_msgs.msg, sensor_msgs.msg, std_srvs.srv, visualization_msgs.msg' ||
        refuse "The ROS 2 found lacks rclpy or common messages, as said above: install\
 ros-jazzy-rclpy and ros-jazzy-common-interfaces."
}

check_platform "$@"
unset PYENV_VERSION _ROS_WHEELS_BOOTSTRAP_COMPLETE
mkdir -p "$folder"
exec 9<"$folder"
flock 9
requirements=(setup.py setup.cfg requirements/*.txt
    tools/{set_up.sh,build_tf2_msgs.sh,print_requirements.py})
fingerprint=$({ printf '%s\n' "$PWD" "$@"; cat "${requirements[@]}"; } | sha256sum)
if [ -x "$python" ] && [ "$(cat "$folder/fingerprint" 2>/dev/null)" = "$fingerprint" ]; then
    exit 0
fi
make_environment
install_packages "$@"
"$python" -c 'import matplotlib.pyplot, pandas, rerun, softrobot_twin.scripting'
echo "$fingerprint" >"$folder/fingerprint"
