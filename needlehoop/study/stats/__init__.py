"""Statistics of runs and rankings."""
