"""Simulated against measured: a published season of six compartments, in houses of the model's parameter sets (docs/realism.md).

``read_archive`` reads what was published, ``compare`` simulates it with the measured weather, light and CO2, under a grower's set points,
and tells how heat and harvest differ.
"""

from glbench.realism.climate import ClimateComparison, ClimateRun, CompartmentClimate, compare_climate, draw_errors, draw_mean_days
from glbench.realism.comparison import Comparison, HouseComparison, check_pictures, compare, read_comparison, write_picture
from glbench.realism.houses import HOUSES, SHIPPED, House, Settings, choose_houses, read_settings
from glbench.realism.indoor import INDOOR, Indoor, read_indoor
from glbench.realism.published import Archive, Compartment, Weather, read_archive
from glbench.realism.season import Season, simulate

__all__ = [
    "HOUSES", "INDOOR", "SHIPPED", "Archive", "ClimateComparison", "ClimateRun", "Comparison", "Compartment", "CompartmentClimate",
    "House", "HouseComparison", "Indoor", "Season", "Settings", "Weather", "check_pictures", "choose_houses", "compare",
    "compare_climate", "draw_errors", "draw_mean_days", "read_archive", "read_comparison", "read_indoor", "read_settings", "simulate",
    "write_picture",
]  # fmt: skip
