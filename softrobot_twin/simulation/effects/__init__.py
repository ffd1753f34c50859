"""Optional effects around a step: parts, and what watches or replaces a reduced body."""
