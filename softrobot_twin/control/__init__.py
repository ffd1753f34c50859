"""The control loop around a simulation, without ROS: inputs, corrections, limits, timing."""
