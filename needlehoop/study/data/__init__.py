"""What runs, models and the paper left behind, read from files."""
