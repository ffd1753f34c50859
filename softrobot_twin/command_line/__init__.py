"""The commands of ``python -m softrobot_twin``: what each may be told, and what it then calls.

What a command calls is imported when it runs: to declare it takes argparse alone.
"""
