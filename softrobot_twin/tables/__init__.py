"""Columns of tables: channels, what is written of a run, files of commands that are read."""
