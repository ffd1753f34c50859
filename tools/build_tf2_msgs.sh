#!/usr/bin/env bash
# Builds tf2_msgs, the message of /tf, into an environment whose ROS comes from PyPI, which lacks it:
#     tools/build_tf2_msgs.sh FOLDER
# Without a C++ compiler it says so, and the twin publishes no /tf.
set -euo pipefail
folder=$(realpath "$1")
python="$folder/bin/python"

if "$python" -c 'import tf2_msgs.msg' 2>/dev/null; then
    exit 0
fi
if ! command -v c++ >/dev/null || ! command -v cc >/dev/null; then
    echo "There is no C++ compiler (sudo apt install g++): tf2_msgs is not built, and the twin\
 publishes no /tf." >&2
    exit 0
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/msg"
echo 'geometry_msgs/TransformStamped[] transforms' >"$work/msg/TFMessage.msg"
cat >"$work/package.xml" <<'XML'
<package format="3">
  <name>tf2_msgs</name>
  <version>0.36.0</version>
  <description>The message of /tf</description>
  <maintainer email="maintainers@softrobot-twin.example">softrobot_twin maintainers</maintainer>
  <license>BSD</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <depend>geometry_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
XML
cat >"$work/CMakeLists.txt" <<'CMAKE'
cmake_minimum_required(VERSION 3.12)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} msg/TFMessage.msg DEPENDENCIES geometry_msgs)
ament_package()
CMAKE
# The wheels name the folders of headers of the machine that built them.
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
numpy=$("$python" -c 'import numpy; print(numpy.get_include())')
baked=/opt/python/cp312-cp312
{ grep -rlI "$baked" "$folder/share" --include='*.cmake' || true; } | xargs -r sed -i \
    -e "s#$baked/include/python3.12#$headers#g" \
    -e "s#$baked/lib/python3.12/site-packages/numpy/_core/include#$numpy#g"
export PATH="$folder/bin:$PATH" AMENT_PREFIX_PATH="$folder" PYTHONDONTWRITEBYTECODE=1
unset PYTHONPATH
{
    cmake -G Ninja -S "$work" -B "$work/build" -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
        -DCMAKE_PREFIX_PATH="$folder" -DCMAKE_INSTALL_PREFIX="$folder" \
        -DPython3_EXECUTABLE="$python"
    cmake --build "$work/build" --target install
} >"$work/log" 2>&1 || {
    tail -n 20 "$work/log" >&2
    echo "tf2_msgs could not be built, as said above: the twin publishes no /tf." >&2
}
