"""The commands of ``python -m softrobot_twin``: the arguments of each, and the function that it
calls.
"""
