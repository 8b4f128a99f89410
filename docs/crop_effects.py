"""Draws docs/images/crop-effects.svg from docs/measurements/crop-effects.json: ``python -m docs.crop_effects [--only-picture]``.

The equations of the crop with trusses alone, in NumPy, in a climate that is held as the experiment says: temperature of air and canopy,
relative humidity, PAR above the canopy, 700 ppm CO2. All experiments are rows of one integration. It takes a minute and needs matplotlib
(``glbench[video]``); ``--only-picture`` draws from the measurements that are there.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from glbench.model.air import co2_density, saturation_vapour_pressure
from glbench.model.crop.stages import STAGES, YOUNG_STAGES, development_rate
from glbench.model.crop.trusses import CrewControls, TrussParameters, TrussState, TrussTomato
from glbench.model.paper import TOMATO_2
from glbench.model.parameters import ClimateParameters
from glbench.model.shortwave import light_from_above
from glbench.resources import write_atomically

Floats = NDArray[np.float64]
Course = Callable[[float], float]
"""A quantity of the climate by time [day]."""

DOCS = Path(__file__).parent
FILE, PICTURE = DOCS / "measurements" / "crop-effects.json", DOCS / "images" / "crop-effects.svg"
DAY: Final = 86400.0
STEP: Final = 900.0
"""Of the integration by Euler's method [s]."""
DAYS: Final = 100
WEEK: Final = 7
CO2: Final = 700.0
"""[ppm]."""
VANTHOORS: Final = 50
"""Stages of a fruit in Vanthoor (2011)."""
CHANGED: Final = (21, 28)
"""Days of the hot and of the dark week."""
HOT, MILD = 29.0, 20.0
"""Daily means [degC] of the hot week, and of all others."""
DARK: Final = 0.05
"""Share of the light that is left in the dark week."""
HUMID, DRY = 92.0, 72.0
"""Relative humidity [%] of a humid night, and otherwise."""
NIGHTS: Final = {"none": range(0), "in a row": range(10, 20), "apart": range(10, 80, 7)}
"""Humid nights by their number."""
HOURS: Final = (12, 14, 16, 17, 18, 19, 20, 22, 24)
HELD: Final = (75.0, 78.0, 80.0, 82.0, 83.0, 84.0, 84.5, 85.0, 85.5, 86.0, 87.0, 88.0, 90.0, 91.0, 92.0, 93.0, 94.0, 95.0)
"""Relative humidity [%]."""
COLD_SPOTS: Final = {
    name: float(TOMATO_2.parameters.default(name)[TOMATO_2.parameter_names.index("dtColdSpot")]) for name in ("benchmark", "bleiswijk_2020")
}
"""How much colder than the mean the cold spots of a crop are [K], by named set."""
LOSS_DAYS: Final = 60
LAMPS: Final = 45.0
"""PAR of the light whose hours count [W m-2]: 200 umol m-2 s-1 of the sun's."""
COLD: Final = (16.0, 18.0, 20.0, 22.0, 24.0)
"""Temperatures at which a day's fruits ripen [degC]."""
SHARES: Final = (0.1, 0.5, 0.9)


def day_light(time: float) -> float:
    """PAR of a clear day in spring [W m-2]: a sine from 6 to 18 h."""
    return 180.0 * max(0.0, float(np.sin(np.pi * (time % 1 * 24 - 6) / 12)))


def _week(inside: float, outside: float) -> Course:
    return lambda time: inside if CHANGED[0] <= time < CHANGED[1] else outside


def _swing(mean: Course) -> Course:
    return lambda time: mean(time) + 2.0 * float(np.sin(2 * np.pi * (time - 0.375)))


def _nights(humid: range) -> Course:
    return lambda time: HUMID if int(time + 0.5) in humid and not 0.25 <= time % 1 < 0.75 else DRY


def _held(value: float) -> Course:
    return lambda _: value


def _lit(hours: float) -> Course:
    return lambda time: LAMPS if time % 1 * 24 < hours else 0.0


def experiments() -> dict[str, tuple[Course, Course, Course]]:
    """Temperature [degC], relative humidity [%] and PAR [W m-2] by name."""
    mild, dry = _swing(_held(MILD)), _held(DRY)
    rows: dict[str, tuple[Course, Course, Course]] = {
        "plain": (mild, dry, day_light),
        "hot": (_swing(_week(HOT, MILD)), dry, day_light),
        "dark": (mild, dry, lambda time: day_light(time) * _week(DARK, 1.0)(time)),
    }
    rows |= {f"nights {name}": (_held(18.0), _nights(which), day_light) for name, which in NIGHTS.items()}
    rows |= {f"hours {hours}": (_held(MILD), dry, _lit(hours)) for hours in HOURS}
    rows |= {f"held {humidity:g} {name}": (_held(18.0), _held(humidity), day_light) for name in COLD_SPOTS for humidity in HELD}
    return rows


def simulated() -> dict[str, dict[str, Floats]]:
    """By experiment: states at the end of each day (days,), photosynthesis [g m-2] and fresh fruit picked [kg m-2] on it."""
    crop, rows = TrussTomato(), experiments()
    values = dict(zip(TOMATO_2.parameters.record._fields, TOMATO_2.parameters.default(), strict=True))
    p = TrussParameters(**{name: values[name] for name in TrussParameters._fields})
    spots = (next((spot for name, spot in COLD_SPOTS.items() if row.endswith(name)), COLD_SPOTS["benchmark"]) for row in rows)
    p = p._replace(dt_cold_spot=np.array([*spots]))
    house = ClimateParameters(**{name: values[name] for name in ClimateParameters._fields})
    x = TrussState(*(np.full(len(rows), value) for value in crop.starts()["mature_crop"](MILD, p)))
    hands = CrewControls(0.0, 0.0, 0.0, 0.0)
    names = [*TrussState._fields, "young", "sugar", "picked"]
    days = {name: np.zeros((DAYS, len(rows))) for name in names}
    for step in range(round(DAYS * DAY / STEP)):
        time = step * STEP / DAY
        air, humidity, par = (np.array([row[place](time) for row in rows.values()]) for place in range(3))
        leaf_area = crop.leaf_area_index(x, p)
        light = SimpleNamespace(r_par_gh_sun=par, r_par_gh_lamp=0.0, r_par_sun_can=par * light_from_above(leaf_area, house).par_canopy)
        light.r_par_lamp_can = light.r_par_int_lamp_can = 0.0
        vapour = humidity / 100 * saturation_vapour_pressure(air)
        climate = SimpleNamespace(t_air=air, t_can=air, vp_air=vapour, co2_air=co2_density(air, CO2))
        around: Any = SimpleNamespace(lai=leaf_area, light=light, x=climate, p=house, u=hands)
        fluxes = crop.processes(x, around, p)
        rates = crop.rates(x, around, fluxes, p)
        x = TrussState(*(value + STEP * rate for value, rate in zip(x, rates, strict=True)))
        day = int(time)
        days["sugar"][day] += 1e-3 * STEP * fluxes.photosynthesis.mc_air_buf
        days["picked"][day] += 1e-6 * STEP * fluxes.fruit.mc_fruit_har / p.dm_fruit
        if (step + 1) % round(DAY / STEP) == 0:
            for name, value in zip(TrussState._fields, x, strict=True):
                days[name][day] = value
            stages = [getattr(x, f"n_fruit{stage}") for stage in range(1, STAGES + 1)]
            days["young"][day] = sum(stages[:YOUNG_STAGES])
    return {name: {of: values[:, place] for of, values in days.items()} for place, name in enumerate(rows)}


def ripening(temperature: float, stages: int) -> list[float]:
    """Days after set when the shares ``SHARES`` of a day's fruits are ripe at a temperature [degC]: an Erlang distribution."""
    from scipy.special import gammaincinv

    return [float(gammaincinv(stages, share)) / stages / float(development_rate(temperature)) for share in SHARES]


def measured() -> dict[str, Any]:
    """Everything that the picture shows."""
    found = simulated()

    def lost(name: str, days: int) -> float:
        return float(1 - np.exp(-found[name]["sum_rot"][days - 1]))

    weeks = {
        name: {
            "set": np.diff(found[name]["n_set"][WEEK - 1 :: WEEK], prepend=0.0).round(3).tolist(),
            "picked": found[name]["picked"][: DAYS // WEEK * WEEK].reshape(-1, WEEK).sum(axis=1).round(4).tolist(),
            "young": found[name]["young"][::WEEK].round(2).tolist(),
            "supply": found[name]["source_sink"][::WEEK].round(3).tolist(),
        }
        for name in ("plain", "hot", "dark")
    }
    hours = {
        str(one): {
            "left": round(1 - 0.65 * float(found[f"hours {one}"]["injury"][27]), 4),
            "sugar": round(float(found[f"hours {one}"]["sugar"][27]), 3),
        }
        for one in HOURS
    }
    return {
        "ripening": {f"{temperature:g}": {str(n): ripening(temperature, n) for n in (STAGES, VANTHOORS)} for temperature in COLD},
        "weeks": weeks,
        "hours": hours,
        "nights": {name: {"mould": found[f"nights {name}"]["mould"].tolist(), "lost": lost(f"nights {name}", DAYS)} for name in NIGHTS},
        "held": {name: {f"{one:g}": lost(f"held {one:g} {name}", LOSS_DAYS) for one in HELD} for name in COLD_SPOTS},
    }


def read() -> dict[str, Any]:
    """The measurements that are there."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def draw(found: Mapping[str, Any]) -> None:
    """Six panels, as PICTURE."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update({"svg.hashsalt": "crop-effects", "svg.fonttype": "none", "font.size": 9})
    import matplotlib.pyplot as plt
    from scipy.special import gammainc

    figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.0), layout="constrained")
    (ripe, hot, dark), (hours, nights, held) = axes
    time = np.linspace(25.0, 90.0, 200)
    for stages, colour in ((STAGES, "#d17a00"), (VANTHOORS, "#33658a")):
        ripe.plot(time, 100 * gammainc(stages, stages * float(development_rate(MILD)) * time), color=colour, label=f"{stages} stages")
    ripe.set(title="A day's fruits at 20 °C", xlabel="days after set", ylabel="ripe [%]")
    weeks = found["weeks"]
    number = np.arange(1, len(weeks["plain"]["set"]) + 1)
    for axis, name, title in ((hot, "hot", "A week at 29 °C"), (dark, "dark", "A week at 5 % of the light")):
        for what, colour in (("set", "#d17a00"), ("picked", "#33658a")):
            axis.plot(number, 100 * np.array(weeks[name][what]) / np.array(weeks["plain"][what]), color=colour, label=f"fruit {what}")
        axis.axvspan(CHANGED[0] / WEEK + 0.5, CHANGED[1] / WEEK + 0.5, color="#888888", alpha=0.2, lw=0)
        axis.set(title=title, xlabel="week", ylabel="of the plain crop [%]", ylim=(0, None))
    lit = [int(one) for one in found["hours"]]
    best = max(one["sugar"] for one in found["hours"].values())
    hours.plot(lit, [100 * one["left"] for one in found["hours"].values()], color="#d17a00", label="a leaf's photosynthesis")
    hours.plot(lit, [100 * one["sugar"] / best for one in found["hours"].values()], color="#33658a", label="of the day, best = 100")
    hours.set(title="After 4 weeks of long light", xlabel="light [h a day]", ylabel="[%]", ylim=(0, None))
    for (name, one), colour in zip(found["nights"].items(), ("#888888", "#d17a00", "#33658a"), strict=True):
        nights.plot(100 * np.array(one["mould"]), color=colour, label=f"humid nights {name}" if name != "none" else "dry nights")
    nights.set(title="Ten nights of 92 %", xlabel="day", ylabel="diseased [%]")
    for (name, one), colour in zip(found["held"].items(), ("#d17a00", "#33658a"), strict=True):
        held.plot(
            [float(humidity) for humidity in one], [100 * share for share in one.values()], color=colour, label=f"cold spots of {name}"
        )
    held.set(title="60 days at one humidity, 18 °C", xlabel="relative humidity [%]", ylabel="of the crop lost [%]", ylim=(-5, 135))
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.legend(frameon=False, fontsize=8, loc="upper left" if axis is held else "best")
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    if "--only-picture" not in sys.argv:
        write_atomically(FILE, json.dumps(measured(), indent=1) + "\n")
    draw(read())
