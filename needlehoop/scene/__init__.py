"""The scene: arm, table, needle, hoop, cameras and named sensors. Nothing of what is to be done."""
