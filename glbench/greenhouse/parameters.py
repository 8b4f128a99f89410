"""From a grower's page to the parameters of the model."""

from __future__ import annotations

from dataclasses import dataclass

from glbench.errors import ParameterError
from glbench.greenhouse.capability import HOT_PIPES, Capability, capability, screen_saving
from glbench.greenhouse.draft import Draft, Entry
from glbench.greenhouse.page import Lamps, Page
from glbench.model import TOMATO
from glbench.model.plausibility import find_doubts
from glbench.realism.houses import mix_lamps
from glbench.tasks.set_points import BLACKOUT, DOSING, LAMPS, SCREEN, WORKED

_CLOTHS = {"epsThScrFir": (0.05, 0.95), "tauThScrFir": (0.0, 0.5), "kThScr": (1e-6, 2e-3)}
"""Heat radiation that an energy screen takes up and lets through [-], air that it lets through [m s-1 K-0.66]: of the densest and of the
most open cloth. Between them lie those that save less and less."""


@dataclass(frozen=True)
class Greenhouse:
    """A greenhouse of a page."""

    book: str
    """Named set of parameters."""
    entries: tuple[Entry, ...]
    """Parameters that differ from it."""
    assumptions: tuple[str, ...]
    """What the page does not say, with the values that hold instead."""
    doubts: tuple[str, ...]
    """What a grower would look at again; ``refusals``: what cannot be."""
    refusals: tuple[str, ...]
    controls: tuple[str, ...]
    """Controls of the equipment that the house has."""
    capability: Capability | None
    """What it can do; ``None`` when it is refused."""

    @property
    def verdict(self) -> str:
        """``usable``, ``usable, but``, or ``refused``."""
        return "refused" if self.refusals else "usable, but" if self.doubts else "usable"


def lamp_properties(lamps: Lamps, kind: str, draft: Draft) -> tuple[float, dict[str, float]]:
    """Power [W m-2] and parameters of the lamps of a kind, ``hps`` or ``led``."""
    properties = TOMATO.parameters.group("lamps", f"{kind}_2021")
    photons, efficacy = properties["zetaLampPar"], properties["etaLampPar"] * properties["zetaLampPar"]
    entry, light = f"{kind}_lamps", lamps.light
    if lamps.power is not None:
        power = lamps.power.total(draft.floor) / draft.floor
    elif light is not None:
        power = draft.value_or(None, light / efficacy, f"{entry}.power", "W/m2", f"{efficacy:.3g} umol/J of the book {kind}_2021")
    else:
        power = draft.value_or(None, properties["thetaLampMax"], f"{entry}.power", "W/m2", f"the book {kind}_2021")
    if light is None:
        light = draft.value_or(None, power * efficacy, f"{entry}.light", "umol/m2/s", f"{efficacy:.3g} umol/J of the book {kind}_2021")
    share = light / (power * photons) if power > 0.0 else 0.0 if light == 0.0 else float("inf")
    if share > 1.0 - properties["etaLampNir"]:
        msg = (
            f"{entry}: {light:g} umol/m2/s from {power:.4g} W/m2 are {share * photons:.3g} umol/J, and no such lamp gives more than "
            f"{(1.0 - properties['etaLampNir']) * photons:.2g}. Is power electric power in W/m2, and light in umol/m2/s?"
        )
        draft.refusals.append(msg)
    return power, properties | {"etaLampPar": share}


def design(page: Page) -> Greenhouse:
    """The greenhouse of a page, with the units and reasons of its parameters, with doubts, and with what it can do."""
    draft = Draft(page.house.floor_area, page.book)
    tables = (page.house, page.heating, page.co2, page.energy_screen, page.blackout_screen, page.vents)
    for table in tables:
        if table is not None:
            table.fill(draft)
    absent = [name for name, table in ((SCREEN, page.energy_screen), (BLACKOUT, page.blackout_screen), (DOSING, page.co2)) if table is None]
    if page.co2 is None:
        draft.add("phiExtCo2", 0.0, "no [co2] on the page")
    kinds = {kind: lamps for kind, lamps in (("hps", page.hps_lamps), ("led", page.led_lamps)) if lamps is not None}
    if kinds:
        words = " and ".join(f"{kind}_lamps" for kind in kinds)
        powers, lamps = zip(*(lamp_properties(one, kind, draft) for kind, one in kinds.items()), strict=True)
        power, properties = sum(powers), lamps[0]
        if len(lamps) > 1 and power > 0.0:
            properties = mix_lamps(powers[0] / power, *lamps)
        reasons = {"thetaLampMax": f"power of {words}", "etaLampPar": "light / (power * zetaLampPar)"}
        for name, value in (properties | {"thetaLampMax": power}).items():
            draft.add(name, value, reasons.get(name, f"{words} of 2021"))
    else:
        absent.append(LAMPS)
        darkness = {"thetaLampMax": 0.0, "aLamp": 0.0, "tauLampPar": 1.0, "tauLampNir": 1.0, "tauLampFir": 1.0}
        for name, value in darkness.items():
            draft.add(name, value, "no lamps on the page, so no shade of lamps")
    values = draft.book | {name: entry.value for name, entry in draft.entries.items()}
    odd = find_doubts(values)
    doubts = [doubt.text for doubt in odd if not doubt.impossible]
    refusals = draft.refusals
    if not refusals:  # what follows from the impossible need not be told
        refusals += [doubt.text for doubt in odd if doubt.impossible]
    ability = None
    if not refusals:
        try:
            vector = TOMATO.parameters.default(page.book, {name: entry.value for name, entry in draft.entries.items()})
        except ParameterError as error:
            refusals.append(str(error))
        else:
            values = dict(zip(TOMATO.parameter_names, vector.tolist(), strict=True))
            if page.energy_screen is not None and page.energy_screen.saving is not None:
                _fit_screen(page.energy_screen.saving, draft, values)
            if not refusals:
                ability = capability(values, energy_screen=SCREEN not in absent, blackout_screen=BLACKOUT not in absent)
    if ability is not None and page.heating.boiler is not None and ability.pipe_temperature > HOT_PIPES:
        doubts.append(
            f"At full heat the rail pipes are at {ability.pipe_temperature:.0f} degC: these pipes give off less than the boiler's "
            f"{ability.boiler:.0f} W/m2 below {HOT_PIPES:.0f} degC. The house may have more pipes (pipe_length), or a smaller boiler."
        )
    if ability is not None and ability.boiler < 0.8 * ability.cold_heat:
        doubts.append(f"The boiler gives {ability.boiler:.0f} W/m2; 18 degC at -10 degC outside would need {ability.cold_heat:.0f} W/m2.")
    controls = tuple(name for name in WORKED if name not in absent)
    entries, assumptions = tuple(draft.entries.values()), tuple(draft.assumptions)
    return Greenhouse(page.book, entries, assumptions, tuple(doubts), tuple(refusals), controls, ability)


def _fit_screen(saving: float, draft: Draft, values: dict[str, float]) -> None:
    """Give the energy screen, in ``draft`` and ``values``, the cloth with which the closed screen saves so much heat [-]."""
    from scipy.optimize import brentq

    def cloth(openness: float) -> dict[str, float]:
        """From 0, the densest, over 1, the book's, to 2, the most open."""
        weight = openness if openness <= 1.0 else openness - 1.0
        ends = {
            name: (dense, draft.book[name]) if openness <= 1.0 else (draft.book[name], open_) for name, (dense, open_) in _CLOTHS.items()
        }
        return {
            name: low * (high / low) ** weight if name == "kThScr" else low + weight * (high - low) for name, (low, high) in ends.items()
        }

    def excess(openness: float) -> float:
        return screen_saving(values | cloth(openness)) - saving

    most, least = excess(0.0), excess(2.0)
    if most < 0.0 or least > 0.0:
        msg = (
            f"energy_screen.saving = {100.0 * saving:g} %: a closed screen of the model saves {100.0 * (saving + least):.0f} to "
            f"{100.0 * (saving + most):.0f} % of the heat, at 0 degC outside. Is it the saving at night, of this screen alone?"
        )
        draft.refusals.append(msg)
        return
    for name, value in cloth(float(brentq(excess, 0.0, 2.0, xtol=1e-3))).items():
        draft.add(name, value, f"a cloth that saves {100.0 * saving:g} % of the heat at 0 degC outside (energy_screen.saving)")
        values[name] = value
