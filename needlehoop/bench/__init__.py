"""Measurements of this machine: the environment, training, a reward program, the physics."""
