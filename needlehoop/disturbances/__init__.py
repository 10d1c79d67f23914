"""Disturbances of cameras, pictures, scene and robot, in training or in a stress test."""
