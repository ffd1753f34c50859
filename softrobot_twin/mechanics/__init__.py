"""What a body does by itself: forces, their derivatives, and the mappings of points onto it."""
