"""The arm: its kinematics, and its MuJoCo model as plain MJCF. It knows no task."""
