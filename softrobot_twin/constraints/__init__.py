"""Rows of H and values of δ of actuators, effectors, markers and contacts."""
