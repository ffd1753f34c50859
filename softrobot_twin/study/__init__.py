"""Runs without ROS, from the command line, and what is made of their numbers."""
