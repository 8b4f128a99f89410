"""The spread `measured` of docs/uncertainty.md: ``python -m docs.spread_measured [--only-page]``.

Computes glbench/tasks/spreads.csv from the parameter sets of the model, simulates seasons of the training split of glbench/SpringYears-v1
to fit how a season's heat follows the parameters, keeps what was simulated in docs/measurements/spread-measured.json, and writes the
tables of the page. ``--only-page`` simulates nothing.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.agents import read_baseline
from glbench.env import Simulation
from glbench.env.scenario import RunScenarios, Scenes
from glbench.env.uncertainty import DerivedParameters, log_heat, spread_multipliers
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.runners import PrivilegedRunner
from glbench.model import PARAMETER_SETS, TOMATO
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.spreads import HEAT, SPREADS_FILE, Spread, SpreadRow, read_spread

Floats = NDArray[np.float64]

DOCS = Path(__file__).parent
PAGE, FIGURES = DOCS / "uncertainty.md", DOCS / "measurements" / "spread-measured.json"
SPREAD = "measured"
BOOK = "led_2020"
"""The set whose values, other than the lamps', the measured house started from; hps_2020 has the same ones."""
HOUSE = "bleiswijk_2020"
DRAWS: Mapping[str, tuple[str, ...]] = {
    "cDgh": ("cDgh",),
    "hVent": ("hVent",),
    "cWgh": ("cWgh",),
    "kThScr": ("kThScr",),
    "kBlScr": ("kBlScr",),
    "cLeakage": ("cLeakage",),
    "cHecOut": ("cHecOut1", "cHecOut2"),
    "cHecIn": ("cHecIn",),
    "pipes": ("lPipe", "lGroPipe"),
    "rSMin": ("rSMin",),
    "etaGlobAir": ("etaGlobAir",),
}
"""Parameters of the house and the stomata; those of one draw share its number."""
BEYOND = 2.0
"""Where no two published houses differ by more, a parameter stays within this many times the measured distance (in logarithms).

A share (etaGlobAir) stays within the measured distance, because its whole is 1. No standard deviation is more than the cap over this.
"""
TASK, AGENT, SEASON, CHECKED = "SpringYears-v1", "rule_based_unlit", 0, 64

FACTORS = (0.5, 1.0, 2.0)


def multipliers() -> dict[str, float]:
    """By what the measured house differs from the book, of each draw.

    Raises
    ------
    ValueError
        When the parameters of a draw differ by different multipliers.
    """
    book, house = (dict(zip(TOMATO.parameter_names, TOMATO.parameters.default(name).tolist(), strict=True)) for name in (BOOK, HOUSE))
    ratios = {}
    for draw, names in DRAWS.items():
        ratio, *others = (house[name] / book[name] for name in names)
        if not np.allclose(others, ratio, rtol=1e-3):
            msg = f"{', '.join(names)} share a draw, but differ from the book by {ratio:.4g} and {others}."
            raise ValueError(msg)
        ratios[draw] = round(ratio, 4)
    return ratios


def widest_ratio(names: Sequence[str]) -> float:
    """Largest ratio between the values of two published houses, over the parameters ``names``."""
    infos = [TOMATO.parameters.info(name) for name in names]
    values = [[info.values.get(name, info.values["benchmark"]) for name in PARAMETER_SETS if name != HOUSE] for info in infos]
    return max(max(one) / min(one) for one in values)


def rows_of(ratios: Mapping[str, float], elasticities: Mapping[str, float]) -> tuple[SpreadRow, ...]:
    """The lines of the file from the multipliers of the measured house, by draw, and the elasticities of heat, by parameter."""
    rows = []
    for draw, measured in ratios.items():
        names, distance = DRAWS[draw], abs(math.log(measured))
        is_share = any(TOMATO.parameters.info(name).check == "fraction" for name in names)
        cap = max(math.log(widest_ratio(names)), distance * (1.0 if is_share else BEYOND))
        log_sd, low, high = (float(f"{value:.3g}") for value in (min(distance, cap / BEYOND), math.exp(-cap), math.exp(cap)))
        rows += [SpreadRow(name, draw, log_sd, low, high, round(elasticities.get(name, 0.0), 4)) for name in names]
    return tuple(rows)


def file_text(rows: Sequence[SpreadRow]) -> str:
    """The content of spreads.csv."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("spread", "parameter", "draw", "log_sd", "low", "high", "heat_elasticity"))
    for row in rows:
        writer.writerow(
            (SPREAD, row.parameter, row.draw, *(f"{value:g}" for value in (row.log_sd, row.low, row.high, row.heat_elasticity)))
        )
    return text.getvalue()


class Houses(RunScenarios):
    """The scenario of one seed for all runs, in houses of their own: multipliers ``(n, rows)`` of the parameters of a spread."""

    def __init__(self, task: TaskSpec, rows: Sequence[SpreadRow], houses: Floats) -> None:
        super().__init__(task)
        names = task.model_value.parameter_names
        places = tuple(names.index(row.parameter) for row in rows)
        self.parameters = np.tile(self.nominal, (len(houses), 1))
        self.parameters[:, places] *= houses
        DerivedParameters(task.model_value, self.nominal, places).complete(self.parameters)

    def draw(self, seeds: Sequence[int]) -> Scenes:
        """Of the season ``SEASON`` for every run, whatever the seeds."""
        return replace(super().draw([self.task.evaluation.first_seed + SEASON] * len(seeds)), parameters=self.parameters.copy())


def season_heat(task: TaskSpec, rows: Sequence[SpreadRow], houses: Floats) -> list[float]:
    """Heat of a season [kWh m-2] in each of the ``houses`` ``(n, rows)``: the same weather, crop and start."""
    baseline, card, n = read_baseline(AGENT), task_card(task), len(houses)
    simulation = Simulation(task, n, "fast")
    simulation.scenarios = Houses(task, rows, houses)
    runner = PrivilegedRunner(baseline.make(card), task, card, n, TimeLimits())  # type: ignore[arg-type]
    observations = simulation.reset(range(n))
    runner.start()
    heat, alive = np.zeros(n), np.ones(n, bool)
    for step in range(task.steps):
        decision = runner.decide(step, runner.inputs(simulation, observations), alive)
        result = runner.apply(simulation, decision.actions)
        if result.failed or decision.failures:
            msg = f"Step {step} failed: {result.failed or decision.failures}"
            raise RuntimeError(msg)
        observations = result.observations
        heat += result.quantities["heat"]
    return [float(value) for value in heat]


def measure() -> dict[str, Any]:
    """Simulate houses that differ in one parameter by its spread, up and down, then houses that are drawn."""
    task = get_task(TASK).in_split("training")
    ratios = multipliers()
    rows = rows_of(ratios, {})
    sizes = np.array([max(row.log_sd, 0.05) for row in rows])
    one_up = np.exp(np.diag(sizes))
    houses = np.concatenate([np.ones((1, len(rows))), one_up, 1.0 / one_up])
    nominal, *others = season_heat(task, rows, houses)
    up, down = np.array(others).reshape(2, -1)
    elasticities = dict(zip((row.parameter for row in rows), (np.log(up / down) / (2.0 * sizes)).tolist(), strict=True))
    kept: dict[str, Any] = {
        "multipliers": ratios,
        "unit": "kWh m-2",
        "nominal": nominal,
        "up": up.tolist(),
        "down": down.tolist(),
        "elasticities": elasticities,
    }
    for factor in FACTORS:  # without rejection: nothing is outside where no heat is predicted
        drawn = spread_multipliers(Spread(SPREAD, factor, rows), np.array([[1, number] for number in range(CHECKED)], np.uint64))
        kept[f"drawn at {factor:g}"] = {"multipliers": drawn.round(6).tolist(), "heat": season_heat(task, rows, drawn.round(6))}
    return kept


def fit(rows: Sequence[SpreadRow], kept: Mapping[str, Any]) -> list[dict[str, float]]:
    """How well the elasticities predict the heat of the houses that were simulated, for each factor.

    ``r2`` is of ln(heat / nominal); ``wrong`` is the share of houses that the prediction puts on the wrong side of the limits, and
    ``outside`` the share that is outside; ``lowest`` and ``highest`` are heat over nominal of the houses predicted to be within.
    """
    least, most = np.log(HEAT)
    quality = []
    for factor in FACTORS:
        drawn = kept[f"drawn at {factor:g}"]
        truth = np.log(np.array(drawn["heat"]) / kept["nominal"])
        predicted = log_heat(Spread(SPREAD, factor, tuple(rows)), np.log(drawn["multipliers"]))
        outside, refused = ((values < least) | (values > most) for values in (truth, predicted))
        ratios = np.exp(truth[~refused])
        quality.append(
            {
                "factor": factor,
                "r2": float(1.0 - np.sum((truth - predicted) ** 2) / np.sum((truth - truth.mean()) ** 2)),
                "error": float(np.sqrt(np.mean((truth - predicted) ** 2))),
                "outside": float(outside.mean()),
                "wrong": float((outside != refused).mean()),
                "lowest": float(ratios.min()),
                "highest": float(ratios.max()),
            }
        )
    return quality


def tables(kept: Mapping[str, Any]) -> dict[str, str]:
    """The tables of the page."""
    rows = read_spread(SPREAD).rows
    measured = kept["multipliers"]
    widths = [
        "| parameters | measured house, times the book's | sd of the logarithm | lowest | highest | heat, % for 1 % more |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for draw, group in itertools.groupby(rows, key=lambda row: row.draw):
        together = list(group)
        names = ", ".join(f"`{row.parameter}`" for row in together)
        heat = sum(row.heat_elasticity for row in together)
        first = together[0]
        widths.append(f"| {names} | {measured[draw]:.2f} | {first.log_sd:.2g} | {first.low:.2f} | {first.high:.2f} | {heat:+.3f} |")
    heat = [
        "| factor | R² of ln(heat) | typical error | houses outside, simulated | on the wrong side | heat of those kept |",
        "|---:|---:|---:|---:|---:|---|",
    ]
    for one in fit(rows, kept):
        heat.append(
            f"| {one['factor']:g} | {one['r2']:.2f} | {100.0 * (math.exp(one['error']) - 1.0):.0f} % | {100.0 * one['outside']:.0f} % | "
            f"{100.0 * one['wrong']:.0f} % | {one['lowest']:.2f} to {one['highest']:.2f} times |"
        )
    return {"spread": "\n".join(widths), "spread-heat": "\n".join(heat)}


def read() -> dict[str, Any]:
    """What was simulated."""
    kept: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))
    return kept


def filled(page: str) -> str:
    """The page with its tables."""
    return with_tables(page, tables(read()))


def main() -> None:
    """Simulate, keep, write."""
    if "--only-page" not in sys.argv[1:]:
        write_atomically(FIGURES, json.dumps(measure()) + "\n")
        write_atomically(SPREADS_FILE, file_text(rows_of(read()["multipliers"], read()["elasticities"])))
        read_spread.cache_clear()
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
