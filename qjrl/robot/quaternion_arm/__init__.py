"""The cable-driven arm made of quaternion joints: description, kinematics, cables, MJCF."""
