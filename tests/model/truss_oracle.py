"""The tomato crop with trusses once more, to test the model against: one plant stand at a time, in plain numbers and branches.

Nothing of `glbench.model` is imported. The published part is written from the electronic appendix of Vanthoor et al. (2011) and from the
public programs that follow it, with ages of fruits in days as they have them; what is chosen is written from the texts of the modules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

STAGES, YOUNG = 33, 7
DAY, HOUR = 86400.0, 3600.0

Numbers = Mapping[str, float]


class Climate(NamedTuple):
    """What the crop sees: °C, °C, Pa, mg m-3, and photons of PAR that it absorbs and that are above it [umol m-2 s-1]."""

    canopy: float
    air: float
    vapour: float
    co2: float
    absorbed: float
    above: float


def step(z: float) -> float:
    """From 0 to 1; 0.5 at 0."""
    return 1 / (1 + math.exp(-z)) if z > -300 else 0.0


@dataclass(frozen=True)
class Stand:
    """A crop: its states ``x``, what is done to it ``u``, and its parameters ``p``, by public name."""

    x: Numbers
    u: Numbers
    p: Numbers
    climate: Climate

    def numbers(self) -> list[float]:
        return [self.x[f"nFruit{j}"] for j in range(1, STAGES + 1)]

    def masses(self) -> list[float]:
        return [self.x[f"cFruit{j}"] for j in range(1, STAGES + 1)]

    # Vanthoor et al. (2011)

    def photosynthesis(self) -> float:
        """Eqs 10 to 23, of a crop of which long light has injured a share."""
        p, c = self.p, self.climate
        leaves, kelvin, molar = p["sla"] * self.x["cLeaf"], c.canopy + 273.15, p["R"] / 1000
        sound = 1 - p["injuryMax"] * self.x["injury"]
        arrhenius = math.exp(p["eJ"] * (kelvin - p["t25k"]) / (molar * kelvin * p["t25k"]))
        deactivation = (1 + math.exp((p["S"] * p["t25k"] - p["H"]) / molar / p["t25k"])) / (
            1 + math.exp((p["S"] * kelvin - p["H"]) / molar / kelvin)
        )
        potential = leaves * p["j25LeafMax"] * sound * arrhenius * deactivation
        light = p["alpha"] * sound * c.absorbed
        middle = (potential + light) / 2 / p["theta"]
        ratio = potential * light / p["theta"] / middle**2
        electrons = middle * ratio / (1 + math.sqrt(1 - ratio))
        outside = 8.3144598 * kelvin_of(c.air) * c.co2 / (101325.0 * 44.01e-3)
        stomata = p["etaCo2AirStom"] * outside
        gamma = p["cGamma"] * c.canopy / leaves + 20 * p["cGamma"] * (1 - 1 / leaves)
        gross = electrons / 4 * (stomata - gamma) / (stomata + 2 * gamma)
        return p["mCh2o"] * (gross - gross * gamma / stomata) * step(5e-4 * (p["cBufMax"] - self.x["cBuf"]))

    def supply(self) -> float:
        """Eq. B.1."""
        return step(5e-3 * (self.x["cBuf"] - self.p["cBufMin"]))

    def warmth(self) -> float:
        """Growth of all organs by the mean temperature of the day. Eqs 28, B.2."""
        p, mean = self.p, self.x["tCan24"]
        return (0.047 * mean + 0.060) * step(1.1587 * (mean - p["tCan24Min"])) * step(-1.3904 * (mean - p["tCan24Max"]))

    def fruit_flow(self) -> float:
        """Eq. 24: what a crop that is full of fruits sends to them."""
        p, now = self.p, self.climate.canopy
        at_once = step(0.869 * (now - p["tCanMin"])) * step(-0.5793 * (now - p["tCanMax"]))
        along, beyond = self.x["tCanSum"] / p["tEndSum"], (self.x["tCanSum"] - p["tEndSum"]) / p["tEndSum"]
        ramp = 0.5 * (along + math.sqrt(along**2 + 1e-4)) - 0.5 * (beyond + math.sqrt(beyond**2 + 1e-4))
        return self.supply() * self.warmth() * at_once * ramp * p["rgFruit"]

    def maintenance(self) -> float:
        """Eq. 45, of an organ that costs 1 s-1 at 25 °C."""
        return (1 - math.exp(-self.p["cRgr"] * self.p["rgr"])) * math.pow(self.p["q10m"], (self.x["tCan24"] - 25) / 10)

    def life(self, mean: float) -> float:
        """Days from set to ripe. De Koning (1994), a hundred times as slow as at 10 °C at most."""
        return 100 / max(0.1 * mean - 0.066, 0.01)

    def potential(self, mean: float) -> tuple[list[float], list[float]]:
        """Weight [mg] and gain [mg day-1] of a fruit in the middle of each stage. Eqs 37 to 39."""
        life = self.life(mean)
        inflexion = -4.93 + 0.548 * life
        b = 1 / (2.44 + 0.403 * inflexion)
        weights, gains = [], []
        for j in range(STAGES):
            age = (2 * j + 1) / (2 * STAGES) * life
            inner = math.exp(-b * (age - inflexion))
            weights.append(self.p["gMax"] * math.exp(-inner))
            gains.append(self.p["gMax"] * math.exp(-inner) * b * inner)
        return weights, gains

    def fruits_set(self) -> float:
        """Eqs 29, 30 and B.4 [m-2 s-1]; heat, cold and pruning take flowers."""
        p, mean = self.p, self.x["tCan24"]
        left = 1.0
        if mean > p["tSetHot"]:
            left *= max(0.0, 1 - p["setHot"] * (mean - p["tSetHot"]))
        if mean < p["tSetCold"]:
            left *= max(0.0, 1 - p["setCold"] * (p["tSetCold"] - mean))
        flowers = p["nStem"] * p["nTruss"] * self.trusses()
        carbohydrate = step(58.9 * (self.fruit_flow() - 0.05))
        return flowers * left * (1 - self.u["uPrune"]) * carbohydrate

    def trusses(self) -> float:
        """Of a stem that flowers [s-1]."""
        appearing = max(0.0, self.p["cTruss1"] + self.p["cTruss2"] * self.x["tCan24"]) * step(self.x["tCanSum"] / 20)
        return 0.0 if self.u["uTop"] == 1 else (1 - self.u["uTop"]) * appearing

    # What is added

    def load(self) -> float:
        """Growth that the fruits could have at 20 °C, over Vanthoor's flow."""
        _, gains = self.potential(20.0)
        return sum(n * g for n, g in zip(self.numbers()[1:], gains[1:], strict=True)) / DAY / self.p["rgFruit"]

    def aborting(self) -> float:
        """[s-1]: such that TOMGRO's share is lost of fruits that spend a 33rd of their life at 20 °C in each of seven stages."""
        share = max(0.0, self.p["abortMax"] - self.p["abortSlope"] * self.x["sourceSink"])
        youth = self.life(20.0) * DAY * YOUNG / STAGES
        return -math.log(1 - share) / youth

    def wet(self, surface: float) -> float:
        spot = surface - self.p["dtColdSpot"]
        saturated = 610.78 * math.exp(17.2694 * spot / (spot + 238.3))
        return step((self.climate.vapour - saturated) / (0.03 * saturated))

    def infection(self) -> float:
        """A beta function of temperature that is 1 at its optimum, times a share of half at so many wet hours."""
        low, best, high = (self.p[f"tMould{name}"] for name in ("Min", "Opt", "Max"))
        mean, hours = self.x["tCan24"], self.x["wetHours"]
        if mean >= high:
            return 0.0
        # The coldest infection is that of a hundredth of a kelvin above the least temperature.
        warmth = (high - mean) / (high - best) * math.pow(max(mean - low, 0.01) / (best - low), (best - low) / (high - best))
        return warmth * hours**2 / (hours**2 + self.p["hoursWet"] ** 2)

    def terms(self) -> dict[str, list[float]]:
        """What each state gains and loses [unit of the state s-1]."""
        x, u, p, c = self.x, self.u, self.p, self.climate
        fruits_set, most, level = self.fruits_set(), self.fruit_flow(), self.maintenance()
        weights, gains = self.potential(x["tCan24"])
        number, mass = self.numbers(), self.masses()
        in_set = fruits_set * weights[0]
        load = self.load()
        growth = (most - in_set) * (1 + 2.96 / 9) * load / (load + 2.96 / 9)
        full = self.supply() * self.warmth()
        leaf_respired, stem_respired = level * p["cLeafM"] * x["cLeaf"], level * p["cStemM"] * x["cStem"]
        topped, growing = u["uTop"], 1 - u["uTop"]
        leaf = growing * full * p["rgLeaf"] + topped * min(full * p["rgLeaf"], leaf_respired)
        stem = growing * full * p["rgStem"] + topped * min(full * p["rgStem"], stem_respired)
        taken = 1 + x["mould"] / (p["mouldShare"] + x["mould"] / 20)  # by a crew, the faster the more there is
        rot, abort, at_work = taken * x["mould"] / p["tauMould"] / DAY, self.aborting(), 1 - u["uAway"]
        passing = STAGES / self.life(x["tCan24"]) / DAY
        green = (x["cFruit"] - x["cRipe"]) / (sum(mass) + 1e-9)
        ripening, respired = green * passing * mass[-1], level * p["cFruitM"]
        picked = at_work * x["cRipe"] / (2 * HOUR)
        largest = p["laiMax"] / p["sla"] * max(1 - u["uDefoliate"], 0.5)
        leaves_picked = at_work * 1e5 * step(2 * math.log(100) * (x["cLeaf"] - largest) / 1e4)
        diseased = min(x["cLeaf"], 2 * max(0.0, x["cLeaf"] - 0.1 * p["laiMax"] / p["sla"]))
        wet = (self.wet(c.canopy) + self.wet(x["tFruit"])) / 2
        beyond = max(0.0, 24 * x["photoperiod"] - p["hoursLight"]) / (24 - p["hoursLight"])
        grown = p["cFruitG"] * (in_set + growth) + p["cLeafG"] * leaf + p["cStemG"] * stem
        infected = p["growthMould"] / DAY * self.infection() * (x["mould"] + p["arrivingMould"]) * (1 - x["mould"])
        rates = {
            "tCan24": [c.canopy / DAY, -x["tCan24"] / DAY],
            "cBuf": [self.photosynthesis(), -in_set, -growth, -leaf, -stem, -grown],
            "cLeaf": [leaf, -leaf_respired, -leaves_picked, -rot * diseased],
            "cStem": [stem, -stem_respired],
            "cFruit": [in_set, growth, -respired * x["cFruit"], -green * abort * sum(mass[:YOUNG]), -rot * x["cFruit"], -picked],
            "tCanSum": [c.canopy / DAY],
            "tCan24Sum": [x["tCan24"]],
            "sumBufOrg": [self.supply()],
            "sumGrowFruit": [growth],
            "nSet": [fruits_set],
            "sumRot": [rot],
            "tFruit": [c.air / p["tauFruit"], -x["tFruit"] / p["tauFruit"]],
            "cRipe": [ripening, -respired * x["cRipe"], -rot * x["cRipe"], -picked],
            "trusses": [self.trusses()],
            "photoperiod": [c.above / (c.above + 5) / (2 * DAY), -x["photoperiod"] / (2 * DAY)],
            "injury": [beyond**2 / (p["tauInjury"] * DAY) * (1 - x["injury"]), -x["injury"] / (p["tauRecovery"] * DAY)],
            "sourceSink": [self.supply() / (2 * DAY), -x["sourceSink"] / (2 * DAY)],
            "wetHours": [wet / HOUR, -(1 - wet) * x["wetHours"] / (p["tauDry"] * HOUR)],
            "mould": [infected, -rot],
            "cWeek": [picked, -x["cWeek"] / (7 * DAY)],
            "nRipe": [passing * number[-1], -at_work * x["nRipe"] / (2 * HOUR), -rot * x["nRipe"]],
            "sumMcFruitHar": [picked],
        }
        wanted = sum(n * g for n, g in zip(number[1:], gains[1:], strict=True))
        for j in range(STAGES):
            lost = rot + (abort if j < YOUNG else 0.0)
            before = (passing * number[j - 1], passing * mass[j - 1]) if j else (fruits_set, in_set)
            gain = growth * number[j] * gains[j] / wanted if j and wanted else 0.0
            rates[f"nFruit{j + 1}"] = [before[0], -passing * number[j], -lost * number[j]]
            rates[f"cFruit{j + 1}"] = [before[1], gain, -passing * mass[j], -lost * mass[j], -respired * mass[j]]
        return rates


def kelvin_of(celsius: float) -> float:
    return celsius + 273.15
