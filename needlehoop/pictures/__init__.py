"""Pictures and films for people. What agents see is made in ``envs``."""
