"""A task's greenhouse as an FMU: FMI 2.0 co-simulation, for Simulink, Dymola, OpenModelica, fmpy and other importers.

``export_fmu`` writes the file with PythonFMU; ``slave`` is what runs in it. See docs/fmu.md.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.fmu.export import export_fmu
else:
    __getattr__ = lazy_names(__name__)

__all__ = ["export_fmu"]
