"""A short task; one thread for JAX."""

from tests.jax.conftest import day as day
