"""Gaussian processes in float64: kernels, marginal likelihood, fit, posterior, more rows, the choice of the next inputs."""
