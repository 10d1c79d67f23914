"""Cameras by drawing triangles into a depth buffer: what agents see, at a tenth of the cost."""
