"""glbench: a reproducible benchmark for greenhouse climate control on the GreenLight model."""

from importlib.metadata import version

from glbench.registration import register_tasks

__version__ = version("glbench")

register_tasks()
