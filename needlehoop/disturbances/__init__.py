"""What cameras, lamps and robots do wrong: nothing by default; in training, or in a stress test."""
