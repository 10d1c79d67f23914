"""The scene: arm, table, cameras and named sensors. Nothing of what is to be done."""
