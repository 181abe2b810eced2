"""The paper's protocol of inverse kinematics."""
