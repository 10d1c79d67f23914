"""The scene: arm, table, cameras and named sensors. It knows no task."""
