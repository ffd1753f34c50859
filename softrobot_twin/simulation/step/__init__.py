"""One step: linearize, condense, find the actuation, correct; and what it works on."""
