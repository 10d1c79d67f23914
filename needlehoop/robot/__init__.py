"""The arm: its kinematics, and its bodies and shapes as a MuJoCo model. Nothing of the task."""
