"""Runs without ROS, studies of accuracy and speed, and their tables and pictures."""
