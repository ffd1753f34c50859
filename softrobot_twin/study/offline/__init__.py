"""A scene explained, or run from a file without ROS and without a clock."""
