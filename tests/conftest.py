"""Settings of every test: double precision, as the `qjrl` command sets it."""

import jax

jax.config.update("jax_enable_x64", True)
