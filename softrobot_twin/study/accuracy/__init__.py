"""What accuracy costs, the setting to choose for a rate, and a real beam to be judged by."""
