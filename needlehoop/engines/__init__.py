"""Engines: physics and cameras of n scenes. No task logic."""
