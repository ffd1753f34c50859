"""What all rigid shapes share, and their forms."""
