"""Tables of whole runs: columns that are written, and files that are read."""
