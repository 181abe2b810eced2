"""The arm under control: targets, base commands, the residual environment and its randomisation."""
