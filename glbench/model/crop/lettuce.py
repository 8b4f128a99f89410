"""The lettuce crop: light and CO2 become stored carbohydrate, which becomes leaves and roots.

Two states: non-structural dry matter (sugars, starch) and structural dry matter, both counted as CH2O. Everything is per floor
area; the symbols are those of the paper, with sigma as ``s`` and the two gammas in words. Source: van Henten (1994), Validation
of a dynamic lettuce growth model for greenhouse climate control, Agricultural Systems 45, 55-72. Van Straten, van Willigenburg,
van Henten and van Ooteghem (2011), Optimal control of greenhouse cultivation, chapter 6, takes the crop up again.

How this was checked. The equations and the values, all but the chosen `laiSat`, `dmSht` and `nHead`, agree with public
implementations that quote the paper or its sensitivity analysis (van Henten and van Straten, Journal of Agricultural Engineering
Research 59, 19-31, 1994); one, of a plant factory, has every one of these values. The others differ from it in `cBeta` (0.72 instead
of 0.8), `cTau` (0.15, of a crop in soil, instead of 0.07), `sStm` (0.005 or 0.02 instead of 0.007), `cGrHalf` (1.2, fitted, instead of
1), the compensation point (71.5 instead of 40 ppm) and `sBnd` (a function of leaf size, wind and leaf area). The full text of the two
papers and of the book was not at hand, so the papers named in the table as sources of a value are quoted at second hand.

The paper takes CO2 in ppm, of 1.83 mg m-3 each whatever the temperature (right at 20 °C). Here the density itself comes in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from glbench.model.bounds import Horizon
from glbench.model.expressions import Expr, exp, fmax, sqrt, square
from glbench.model.model import Flow, ObservedColumn, Signal, Step, Stock
from glbench.model.parameter_table import read_table
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import Crop, CropStart
from glbench.model.surroundings import CropExchange, Surroundings

KILOGRAMS = 1e-6
"""Turns milligrams to kilograms [kg mg-1]."""

GRAMS = 1e3
"""Turns kilograms to grams [g kg-1]."""

CARBOXYLATION_ROUNDING = 1e-16
"""Added to a squared conductance [m2 s-2] under a root: rounds the carboxylation's onset within 1e-4 K of 5 and 40 °C."""

NO_LIGHT = 1e-24
"""Added to the sum of two CO2 fluxes [kg m-2 s-1]: both are 0 in darkness outside 5 to 40 °C."""

NO_CROP = 1e-15
"""Added to the dry matter that limits growth [kg m-2]: keeps the growth of an empty bed at 0 instead of 0/0."""

YOUNG_HEAD = 3.0
"""Fresh mass of a young plant when it is set [g]."""

YOUNG_STRUCTURAL = 0.75
"""Share of structural matter in the dry matter of a young plant [-]."""


LIGHTEST_SOLD = 180.0
"""Fresh mass below which a head earns nothing [g]; chosen, of the usual trade."""

FULL_PRICE = 250.0
"""Fresh mass from which a head earns its full price [g]; the price rises linearly in between. Chosen, of the usual trade."""

AT_FULL_PRICE = "at full price"
"""How heads are counted where some earn less than the full price."""

LARGEST_HEAD = 2000.0
"""Largest fresh mass of a head that is shown [g]."""

_MOST_DRY_MATTER = 5.0  # kg m-2; 25 heads of 2 kg are 2.4 kg m-2
_LARGEST_LEAF_AREA = 350.0  # m2 m-2; all of that as leaves
_BELOW_ZERO = 0.1  # kg m-2; the store is drawn below zero in long darkness


class LettuceState(NamedTuple):
    """State of the lettuce; also used for its time derivative (the unit then gains s-1)."""

    x_n: Annotated[Expr, Variable("kg m-2", "non-structural dry matter; slightly negative in long darkness", scale=0.1, small=1e-4)]
    x_s: Annotated[Expr, Variable("kg m-2", "structural dry matter", scale=0.1, small=1e-4)]


class CropClimate(NamedTuple):
    """What the lettuce sees of the climate."""

    t_can: Annotated[Expr, Quantity("°C", "temperature of the canopy")]
    co2_air: Annotated[Expr, Quantity("mg m-3", "CO2 density of the main air")]
    par: Annotated[Expr, Quantity("W m-2", "PAR above the canopy, of sun and top lamps")]


class LettuceParameters(NamedTuple):
    """One value for each parameter of the lettuce; unit, meaning and source stand in lettuce.csv."""

    c_alpha: Expr
    c_beta: Expr
    c_tau: Expr
    c_lar: Expr
    c_k: Expr
    lai_sat: Expr
    c_gr_max: Expr
    c_gr_half: Expr
    q10_gr: Expr
    c_resp_sht: Expr
    c_resp_rt: Expr
    q10_resp: Expr
    c_eps: Expr
    co2_comp20: Expr
    q10_comp: Expr
    s_bnd: Expr
    s_stm: Expr
    s_car1: Expr
    s_car2: Expr
    s_car3: Expr
    dm_sht: Expr
    n_head: Expr


class Photosynthesis(NamedTuple):
    """From light and CO2 to carbohydrate."""

    co2_comp: Annotated[Expr, Quantity("kg m-3", "CO2 compensation point")]
    s_car: Annotated[Expr, Quantity("m s-1", "conductance of carboxylation")]
    s_co2: Annotated[Expr, Quantity("m s-1", "conductance to CO2 from the air to the carboxylation")]
    f_phot_max: Annotated[Expr, Quantity("kg m-2 s-1", "CO2, gross photosynthesis of a closed canopy")]
    f_phot: Annotated[Expr, Quantity("kg m-2 s-1", "CO2, gross photosynthesis; negative below the compensation point")]


class Growth(NamedTuple):
    """From non-structural to structural dry matter."""

    r_gr: Annotated[Expr, Quantity("s-1", "relative growth rate of the structural dry matter")]
    f_gr: Annotated[Expr, Quantity("kg m-2 s-1", "CH2O, non-structural to structural dry matter")]


class Respiration(NamedTuple):
    """Carbohydrate respired."""

    f_resp_main: Annotated[Expr, Quantity("kg m-2 s-1", "CH2O, maintenance respiration")]
    f_resp_gr: Annotated[Expr, Quantity("kg m-2 s-1", "CH2O, respiration of growth")]


class LettuceFluxes(NamedTuple):
    """What matter does in the crop."""

    photosynthesis: Photosynthesis
    growth: Growth
    respiration: Respiration


LETTUCE_PARAMETERS = read_table(LettuceParameters, Path(__file__).with_name("lettuce.csv"))
"""Name, unit, meaning, source and value of the lettuce's parameters, in the order of the vector."""


def start_state(p: LettuceParameters, head: Expr = YOUNG_HEAD) -> LettuceState:
    """State of young plants of a fresh mass ``head`` [g], three parts of their dry matter in four structural.

    The three parts in four are chosen, as in later implementations.
    """
    dry = p.dm_sht * p.n_head * head / (GRAMS * (1 - p.c_tau))
    return LettuceState(x_n=(1 - YOUNG_STRUCTURAL) * dry, x_s=YOUNG_STRUCTURAL * dry)


def leaf_area_index(x: LettuceState, p: LettuceParameters) -> Expr:
    """Leaf area per floor area [m2 m-2] that intercepts light; about 20 in a head of 250 g, most of it folded in."""
    return p.c_lar * (1 - p.c_tau) * x.x_s


def climate_leaf_area_index(x: LettuceState, p: LettuceParameters) -> Expr:
    """Leaf area index [m2 m-2] for optics, long-wave, transpiration, convection and heat capacity of the canopy.

    The same for small plants, `laiSat` at most: the inner leaves of a head meet neither air nor light. Chosen; the transpiration of
    van Henten's greenhouse saturates with ground cover too.
    """
    return p.lai_sat * (1 - exp(-leaf_area_index(x, p) / p.lai_sat))


def q10_factor(q10: Expr, temperature: Expr, reference: float) -> Expr:
    """Rate at a temperature [°C] over that at the reference [-]: ``q10`` for every 10 K."""
    return q10 ** (0.1 * (temperature - reference))


def carboxylation_conductance(t_can: Expr, p: LettuceParameters) -> Expr:
    """Conductance of carboxylation [m s-1]: a parabola above 0 between 5 and 40 °C, 0 elsewhere.

    Its slope runs to 0 at both ends; 1e-3 K inside it is the parabola to 1e-3, at 18 °C to 1e-11.
    """
    parabola = fmax(p.s_car1 * square(t_can) + p.s_car2 * t_can + p.s_car3, 0)
    return square(parabola) / sqrt(square(parabola) + CARBOXYLATION_ROUNDING)


def photosynthesis(x: LettuceState, c: CropClimate, p: LettuceParameters) -> Photosynthesis:
    """Gross photosynthesis of the canopy, limited by light and by the CO2 that reaches the carboxylation.

    The paper's form is half the harmonic mean of the two limits, ``e (C - G) s (C - G) / (e (C - G) + s (C - G))`` with
    ``e = cEps par / (C + 2 G)``, for a closed canopy, times the share of light that the leaves intercept. Cancelling the common ``C - G``
    leaves nothing to divide by 0 at the compensation point; the three conductances in series are written to allow 0 for one of them.
    """
    co2 = KILOGRAMS * c.co2_air
    co2_comp = p.co2_comp20 * q10_factor(p.q10_comp, c.t_can, 20)
    s_car = carboxylation_conductance(c.t_can, p)
    s_leaf = p.s_bnd * p.s_stm / (p.s_bnd + p.s_stm)
    s_co2 = s_leaf * s_car / (s_leaf + s_car)

    by_light = p.c_eps * c.par
    by_co2 = s_co2 * (co2 + 2 * co2_comp)
    f_phot_max = by_light * s_co2 / (by_light + by_co2 + NO_LIGHT) * (co2 - co2_comp)
    return Photosynthesis(
        co2_comp=co2_comp, s_car=s_car, s_co2=s_co2, f_phot_max=f_phot_max, f_phot=(1 - exp(-p.c_k * leaf_area_index(x, p))) * f_phot_max
    )


def growth(x: LettuceState, c: CropClimate, p: LettuceParameters) -> Growth:
    """Growth of structural dry matter out of what is stored.

    Days of darkness draw the store below 0. Growth is negative there: maintenance lives on leaves, and the store stays above about -0.06
    of the structural dry matter. The form needs it above minus `cGrHalf` of that.
    """
    r_gr = p.c_gr_max * q10_factor(p.q10_gr, c.t_can, 20) * x.x_n / (p.c_gr_half * x.x_s + x.x_n + NO_CROP)
    return Growth(r_gr=r_gr, f_gr=r_gr * x.x_s)


def respiration(grown: Growth, x: LettuceState, c: CropClimate, p: LettuceParameters) -> Respiration:
    """Maintenance respiration of shoot and roots, and what growth loses on the way."""
    shoot_and_roots = p.c_resp_sht * (1 - p.c_tau) + p.c_resp_rt * p.c_tau
    return Respiration(
        f_resp_main=shoot_and_roots * x.x_s * q10_factor(p.q10_resp, c.t_can, 25), f_resp_gr=(1 - p.c_beta) / p.c_beta * grown.f_gr
    )


def fluxes(x: LettuceState, c: CropClimate, p: LettuceParameters) -> LettuceFluxes:
    """All fluxes of the crop at a state and a climate."""
    grown = growth(x, c, p)
    return LettuceFluxes(photosynthesis(x, c, p), grown, respiration(grown, x, c, p))


def rates(f: LettuceFluxes, p: LettuceParameters) -> LettuceState:
    """Time derivative of the state [kg m-2 s-1]."""
    ph, gr, re = f
    return LettuceState(x_n=p.c_alpha * ph.f_phot - gr.f_gr - re.f_resp_gr - re.f_resp_main, x_s=gr.f_gr)


def co2_uptake(f: LettuceFluxes, p: LettuceParameters) -> Expr:
    """CO2 taken from the main air, net of both respirations [mg m-2 s-1]; negative at night.

    Respired carbohydrate becomes CO2 by the same `cAlpha` by which it was made, as in the greenhouse models with this crop, so that
    carbon closes: 44/30 would leave 0.3 %.
    """
    ph, _, re = f
    return (ph.f_phot - (re.f_resp_main + re.f_resp_gr) / p.c_alpha) / KILOGRAMS


def dry_mass(x: LettuceState) -> Expr:
    """Dry matter of shoot and roots [kg m-2]."""
    return x.x_n + x.x_s


def fresh_mass(x: LettuceState, p: LettuceParameters) -> Expr:
    """Fresh mass of the shoots per floor area [kg m-2]: what is sold."""
    return (1 - p.c_tau) * dry_mass(x) / p.dm_sht


def head_mass(x: LettuceState, p: LettuceParameters) -> Expr:
    """Fresh mass of one head [g]."""
    return GRAMS * fresh_mass(x, p) / p.n_head


class LettuceSize(NamedTuple):
    """How large the plants are."""

    lai_crop: Annotated[Expr, Quantity("m2 m-2", "leaf area per floor area that intercepts light")]
    head: Annotated[Expr, Quantity("g", "fresh mass of one head")]


class Fluxes(NamedTuple):
    """Everything that the balances of the lettuce are made of, one record a process."""

    photosynthesis: Photosynthesis
    growth: Growth
    respiration: Respiration
    size: LettuceSize
    crop: CropExchange


@dataclass(frozen=True)
class VanHentenLettuce(Crop):
    """Stored and structural dry matter of one planting, from young plants to heads."""

    name: ClassVar[str] = "lettuce"
    State: ClassVar[type[LettuceState]] = LettuceState
    Parameters: ClassVar[type[LettuceParameters]] = LettuceParameters
    table = LETTUCE_PARAMETERS
    observation_modules: ClassVar[Mapping[str, str]] = {"crop": "fresh mass of a head, dry matter, leaf area index"}

    def leaf_area_index(self, x: LettuceState, p: LettuceParameters) -> Expr:
        return climate_leaf_area_index(x, p)

    def processes(self, x: LettuceState, s: Surroundings, p: LettuceParameters) -> Fluxes:
        light = s.light.r_par_gh_sun + s.light.r_par_gh_lamp
        f = fluxes(x, CropClimate(s.x.t_can, s.x.co2_air, light), p)
        size = LettuceSize(leaf_area_index(x, p), head_mass(x, p))
        return Fluxes(*f, size, CropExchange(co2_uptake(f, p)))

    def rates(self, x: LettuceState, s: Surroundings, fluxes: Fluxes, p: LettuceParameters) -> LettuceState:
        return rates(LettuceFluxes(fluxes.photosynthesis, fluxes.growth, fluxes.respiration), p)

    def starts(self) -> Mapping[str, CropStart]:
        return {"young_lettuce": lambda air_temperature, p: start_state(p)}

    def flows(self) -> tuple[Flow, ...]:
        def gained(step: Step) -> Expr:
            return fresh_mass(step.after, step.parameters) - fresh_mass(step.before, step.parameters)

        return (Flow("fresh_growth", "kg m-2", "fresh mass gained by the shoots", "Fresh mass", gained),)

    def stocks(self) -> tuple[Stock, ...]:
        meaning = f"heads at full price: none below {LIGHTEST_SOLD:g} g, all from {FULL_PRICE:g} g fresh, in between a share of each"
        fresh = Stock("fresh_mass", "kg m-2", "fresh mass of the shoots", "Fresh mass", fresh_mass)
        return (fresh, Stock("heads", "m-2", meaning, "Heads", saleable_heads, AT_FULL_PRICE))

    def signals(self) -> tuple[Signal, ...]:
        return (
            Signal("crop/head", "Fresh mass of a head", "g", "head", of=head_mass),
            Signal("crop/stored", "Dry matter, stored", "g m⁻²", "xN", GRAMS),
            Signal("crop/structural", "Dry matter, structural", "g m⁻²", "xS", GRAMS),
            Signal("crop/leaf_area_index", "Leaf area index", "m² m⁻²", "leaf_area", of=leaf_area_index),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return {"xN": (-_BELOW_ZERO, _MOST_DRY_MATTER), "xS": (-_BELOW_ZERO, _MOST_DRY_MATTER)}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "crop":
            return None
        return (
            ObservedColumn("head_fresh_mass", "g", "fresh mass of one head", "head", -10.0, LARGEST_HEAD, of=head_mass),
            ObservedColumn(
                "dry_matter", "kg m-2", "dry matter of shoot and roots", "dry", -_BELOW_ZERO, 2 * _MOST_DRY_MATTER,
                of=lambda x, p: dry_mass(x),
            ),
            ObservedColumn(
                "leaf_area_index", "m2 m-2", "leaf area per floor area that intercepts light", "leaf_area", -10.0, _LARGEST_LEAF_AREA,
                of=leaf_area_index,
            ),
        )  # fmt: skip


def saleable_heads(x: Any, p: Any) -> Expr:
    """Heads per floor area, counted by the share of the full price that they earn [m-2]."""
    share = (head_mass(x, p) - LIGHTEST_SOLD) / (FULL_PRICE - LIGHTEST_SOLD)
    return np.minimum(np.maximum(share, 0.0), 1.0) * p.n_head
