"""Pictures and films for people, and windows. What agents see is made in ``envs``."""
