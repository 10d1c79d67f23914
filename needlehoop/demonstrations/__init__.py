"""Episodes for learners elsewhere: who flies them, and the layouts in which they are written."""
