"""Bodies of few unknowns from large ones: bases, training, superelements of vertebrae."""
