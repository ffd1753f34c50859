"""The file of a run: everything that reached the loop of a twin, and all that it gave."""
