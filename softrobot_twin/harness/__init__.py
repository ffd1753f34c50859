"""What all offline runs stand on: cases, workers, samples, equilibria, files, tables, pictures."""
