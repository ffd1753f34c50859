"""Closing the loop around a simulation: what comes in, what may go out, and when. No ROS here."""
