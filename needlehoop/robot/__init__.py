"""The arm: its kinematics, and its MuJoCo model as plain MJCF. Nothing of the task."""
