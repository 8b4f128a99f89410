"""Controllers of the suite lettuce-classic, van Henten's lettuce greenhouse with four states: a grower's rules, and predictive control.

The rules are those of the package lettuce-greenhouse-gym 0.1.3. Predictive control solves the problem of that package, profit minus what
violations cost over the hours ahead along the model's own step, with CasADi's solver ``fatrop``. Unlike the package's it sees observations
only. They tell the state but for vapour above saturation, and the weather of the hours ahead.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from glbench.agents.controllers import ObservedController, controller
from glbench.agents.protocol import check_runs
from glbench.arrays import Floats
from glbench.control import EndValue
from glbench.env.random import key_of, uniforms
from glbench.errors import SubmissionError, refuse
from glbench.model import LETTUCE_CLASSIC, co2_density, co2_ppm, relative_humidity, vapour_density
from glbench.model.air import saturation_vapour_pressure, vapour_pressure
from glbench.model.model import Step
from glbench.settings import Table, read_settings
from glbench.tasks.ledger import STOCK

if TYPE_CHECKING:
    from glbench.tasks import TaskCard, TaskSpec

_AIR = ("air_temperature", "co2", "relative_humidity")
_OUTSIDE = ("global_radiation", "outdoor_temperature", "outdoor_vapour_density", "outdoor_co2_density")
_CONTROLS = ("co2_supply", "ventilation", "heating")  # what controls deliver
_Gain = Annotated[float, Field(ge=0.0)]


class LettuceRuleSettings(Table):
    """Numbers of the rules; ``baselines/rule_based_lettuce/settings.yml`` explains each."""

    temp_day: float
    temp_night: float
    day_radiation: _Gain
    heat_gain: _Gain
    vent_deadband: float
    vent_temp_gain: _Gain
    rh_max: Annotated[float, Field(gt=0.0, le=100.0)]
    vent_rh_gain: _Gain
    co2_target: _Gain
    co2_gain: _Gain
    co2_vent_cutoff: float


@controller("rule_based_lettuce", read=partial(read_settings, LettuceRuleSettings, what="the rules for lettuce"), version="1")
class LettuceRules(ObservedController):
    """Heat when it is cold, ventilate when it is hot or humid, dose CO2 by day while vents are nearly shut; an ``Agent``."""

    title = "the rules for lettuce"

    def __init__(self, settings: LettuceRuleSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin. Raises ``SubmissionError`` when the task does not show the air and the sun."""
        self.begin(task, n_runs, (*_AIR, _OUTSIDE[0], *_CONTROLS))
        self._controls = {control.quantity: control for control in task.controls}

    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions towards what the rules ask for."""
        n, (warm, co2, humidity, sun, *_) = self.settings, readings.values()
        day = sun > n.day_radiation
        above = warm - np.where(day, n.temp_day, n.temp_night)
        vents = n.vent_temp_gain * np.maximum(above - n.vent_deadband, 0.0) + n.vent_rh_gain * np.maximum(humidity - n.rh_max, 0.0)
        opening = np.minimum(vents, self._controls["ventilation"].at_one)
        dosing = np.where(day & (opening <= n.co2_vent_cutoff), n.co2_gain * (n.co2_target - co2), 0.0)
        amounts = zip((self._controls[name] for name in _CONTROLS), (dosing, vents, -n.heat_gain * above), strict=True)
        return self.towards({control.name: np.clip(amount / control.at_one, 0.0, 1.0) for control, amount in amounts}, positions)


class LettucePlanSettings(Table):
    """``draws``: of the coefficients, for whose mean a plan is the best; 0: for the nominal ones. ``end_value`` as of ``EndValue.read``."""

    horizon_hours: Annotated[float, Field(gt=0.0, le=48.0)]
    draws: Annotated[int, Field(ge=0, le=64)] = 0
    end_value: dict[str, Any] | None = None


_SCALES = np.array([0.1, 1e-3, 10.0, 1e-2])  # of the states
_PER_EUR = 100.0  # The solver's tolerance is absolute: a step earns about a cent
_SLACK = 1e-2  # Violations of the first guess lie above what they are at least, in their scale
_FREE, _SHARE = (-np.inf, np.inf), (0.0, 1.0)
_FATROP = {"print_level": 0, "tol": 1e-4, "mu_init": 1e-5, "max_iter": 200}  # mu_init: it begins close to the plan before


def _violations(task: TaskSpec, state: Any) -> tuple[list[Any], list[float]]:
    """How far the air is beyond each limit, as a share of a tenth of the range allowed, and what that costs in a step [EUR m-2]."""
    pressure = vapour_pressure(state[2], state[3])
    air = dict(zip(_AIR, (state[2], co2_ppm(state[2], state[1] * 1e6), relative_humidity(state[2], pressure)), strict=True))
    prices, hours = task.violation_prices or {}, task.step_seconds / 3600.0
    distances, costs = [], []
    for name, limits in task.constraints.items():
        scale, price = 0.1 * (limits.high - limits.low), prices[name]
        sides = [(air[name] - limits.high, price), (limits.low - air[name], task.lower_prices.get(name, price))]
        for distance, cost in sides if limits.low > 0.0 or name == "air_temperature" else sides[:1]:
            distances.append(distance / scale)
            costs.append(cost * hours * scale)
    return distances, costs


def _profit(task: TaskSpec, step: Step) -> Any:
    """What the ledger counts in a step [EUR m-2], an expression."""
    flows = {flow.name: flow.amount(step) for flow in task.model_value.flows()}
    for stock in task.model_value.stocks():
        flows[stock.name] = stock.amount(step.after, step.parameters) - stock.amount(step.before, step.parameters)
    return sum(item.sign * float(item.price) * item.factor * flows[item.flow] for item in task.ledger.items)


def _problem(task: TaskSpec, horizon: int, draws: int) -> tuple[ca.Function, ca.Function, dict[str, list[float]], int]:
    """The optimal control problem of ``horizon`` steps for ``draws`` draws of the coefficients, whose mean counts.

    Returns the solver; what makes its first guess of controls ahead ``(controls, steps)`` and of parameters (state, controls now, weather,
    coefficients, worth of the states at the end); bounds; how many states a stage has: those of all draws, and the controls before it.
    """
    model, step = task.model_value, task.model_value.step_function(task.step_seconds)
    n, m = len(_SCALES), len(_CONTROLS)
    x0, before, ahead, worth = ca.SX.sym("x0", n), ca.SX.sym("before", m), ca.SX.sym("ahead", m, horizon), ca.SX.sym("worth", n)
    count = draws * len(_violations(task, x0)[1])
    weather = ca.SX.sym("weather", len(model.disturbances), horizon)
    coefficients = [ca.SX.sym(f"p{k}", len(model.parameter_names), draws) for k in range(horizon)]
    width, most = draws * n + m, task.actuation.max_change
    stages = [ca.SX.sym(f"x{k}", width) for k in range(horizon + 1)]
    variables, equations, guess, x_bounds, g_bounds = [], [], [], [], []
    states, controls, cost = [x0] * draws, before, ca.SX(0)
    for k, stage in enumerate(stages[:-1]):
        u, slacks, after, excess = ca.SX.sym(f"u{k}", m), ca.SX.sym(f"s{k}", count), [], []
        guess += [*(x / _SCALES for x in states), controls, ahead[:, k]]
        for i, slack in enumerate(ca.vertsplit(slacks, count // draws)):
            x, p = stage[n * i : n * (i + 1)] * _SCALES, coefficients[k][:, i]
            x_next = step(x, u, weather[:, k], p)
            distances, prices = _violations(task, x_next)
            states_in, states_out = (model.State(*ca.vertsplit(one)) for one in (x, x_next))
            inputs = model.Controls(*ca.vertsplit(u)), model.Parameters(*ca.vertsplit(p))
            cost += (ca.dot(ca.DM(prices), slack) - _profit(task, Step(states_in, states_out, *inputs, task.step_seconds))) / draws
            after.append(x_next / _SCALES)
            excess.append(ca.vertcat(*distances) - slack)
            states[i] = step(states[i], ahead[:, k], weather[:, k], p)
            guess.append(ca.fmax(ca.vertcat(*_violations(task, states[i])[0]), 0.0) + _SLACK)
        controls = ahead[:, k]
        begin = [] if k else [stage - ca.vertcat(*[x0 / _SCALES] * draws, before)]
        variables += [stage, u, slacks]
        equations += [stages[k + 1] - ca.vertcat(*after, u), *begin, *excess, u - stage[-m:]]
        x_bounds += [_FREE] * (draws * n) + [_SHARE if k else _FREE] * m + [_SHARE] * m + [(0.0, np.inf)] * count
        g_bounds += [(0.0, 0.0)] * (width * (1 + len(begin))) + [(-np.inf, 0.0)] * count + [(-most, most)] * m
    for i in range(draws):
        cost -= ca.dot(worth, stages[-1][n * i : n * (i + 1)] * _SCALES) / draws
    guess += [*(x / _SCALES for x in states), controls]
    parameters = ca.vertcat(x0, before, ca.vec(weather), *map(ca.vec, coefficients), worth)
    problem = {"x": ca.vertcat(*variables, stages[-1]), "f": _PER_EUR * cost, "g": ca.vertcat(*equations), "p": parameters}
    equality = [low == high for low, high in g_bounds]
    options: dict[str, Any] = {"structure_detection": "auto", "equality": equality, "print_time": False, "fatrop": _FATROP}
    x_bounds += [_FREE] * (draws * n) + [_SHARE] * m
    (lbx, ubx), (lbg, ubg) = (map(list, zip(*pairs, strict=True)) for pairs in (x_bounds, g_bounds))
    start = ca.Function("start", [ahead, parameters], [ca.cse(ca.vertcat(*guess))])
    return ca.nlpsol("plan", "fatrop", problem, options), start, {"lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}, width


@controller("mpc_lettuce", read=partial(read_settings, LettucePlanSettings, what="the settings of predictive control"), version="1")
class LettucePlanner:
    """Predictive control of one plan a step, of which the first step is taken; an ``Agent``. Each plan begins with the one before."""

    def __init__(self, settings: LettucePlanSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin. Raises ``SubmissionError`` for another model, or when something needed is not shown."""
        if task.model != LETTUCE_CLASSIC.id or task.actuation != "rate":
            refuse(f"{task.id} has {task.model}, and this controller plans for {LETTUCE_CLASSIC.id}, through rates.", SubmissionError)
        self._horizon = round(self.settings.horizon_hours * 3600.0 / task.step_seconds)
        self._draws = max(self.settings.draws if task.half_width > 0.0 else 0, 1)
        suffixes = ["", *(f"_ahead_{k}" for k in range(1, self._horizon))]
        inside = ["dry_weight", *_AIR, *_CONTROLS]
        needed = [*inside, *(name + suffix for suffix in suffixes for name in _OUTSIDE)]
        if missing := [name for name in needed if name not in task.observation_names]:
            refuse(f"{task.id} does not show {', '.join(missing)}, without which no plan can be made.", SubmissionError)
        self._places = [task.observation_names.index(name) for name in needed]
        self._most, self._max_change = np.array([control.at_one for control in task.controls]), task.max_change
        self._task, self._step = task.task(), 0
        if not self._task.violation_prices or self._task.ledger.price_tables:
            refuse(f"{task.id} cannot be planned for: violations must have prices, and all other prices must be constant.", SubmissionError)
        self._half_width = task.half_width * np.isin(LETTUCE_CLASSIC.parameter_names, self._task.uncertainty.parameters)
        self._end_value = None if self.settings.end_value is None else EndValue.read(self.settings.end_value)
        self._problem = _problem(self._task, self._horizon, self._draws)
        self._plans, self._vapour = np.zeros((n_runs, self._horizon, len(_CONTROLS))), np.zeros(n_runs)

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """Actions for the coming step. Raises ``ShapeError`` when there are not as many rows as runs."""
        check_runs(observations, len(self._plans))
        rows, outlook = observations[:, self._places].astype(np.float64), self._outlook()
        self._step += 1
        warm, co2, humidity = rows[:, 1:4].T
        vapour = vapour_density(warm, saturation_vapour_pressure(warm) * humidity / 100.0)
        vapour = np.where(humidity < 100.0, vapour, np.maximum(vapour, self._vapour))  # a sensor shows no more than 100 %
        states = np.stack([rows[:, 0], co2_density(warm, co2) * 1e-6, warm, vapour], axis=1)
        controls = np.clip(rows[:, 4:7] / self._most, 0.0, 1.0)
        weather = np.zeros((len(rows), self._horizon, len(LETTUCE_CLASSIC.disturbances)))
        sun, outside, vapour, co2 = rows[:, 7:].reshape(*weather.shape[:2], len(_OUTSIDE)).transpose(2, 0, 1)
        weather[..., :4] = np.stack([sun, outside, vapour_pressure(outside, vapour), co2 * 1e6], axis=-1)
        solver, start, bounds, width = self._problem
        for run in np.flatnonzero(np.isfinite(rows).all(axis=1)):  # if a reading is missing, the run keeps its plan
            parameters = np.concatenate([states[run], controls[run], weather[run].ravel(), outlook])
            solution = np.asarray(solver(x0=start(self._plans[run].T, parameters), p=parameters, **bounds)["x"]).ravel()
            steps = solution[:-width].reshape(self._horizon, -1)
            if np.isfinite(steps).all():
                self._plans[run], self._vapour[run] = steps[:, width : width + len(_CONTROLS)], solution[steps.shape[1] + 3] * _SCALES[3]
        actions: Floats = np.nan_to_num(np.clip((self._plans[:, 0] - controls) / self._max_change, -1.0, 1.0))
        self._plans = np.concatenate([self._plans[:, 1:], self._plans[:, -1:]], axis=1)
        return actions

    def _outlook(self) -> Floats:
        """Coefficients of the steps ahead, and what states are worth at their end."""
        p = np.tile(self._task.parameters(), (self._horizon, self._draws, 1))
        if self.settings.draws:
            steps = np.arange(self._step, self._step + self._horizon)  # each has draws of its own, which stay while it comes nearer
            numbers = uniforms(np.array([key_of("glbench mpc_lettuce")], np.uint64), steps[None], self._draws * p.shape[-1])
            p *= 1.0 + self._half_width * (2.0 * numbers.reshape(p.shape) - 1.0)
        end = (self._step + self._horizon) / self._task.steps_per_day
        worth = np.zeros(len(_SCALES))
        if self._end_value is not None:
            worth = self._end_value(self._task, end % 1.0 * 24.0, self._task.weather.days - end)[0].copy()
            if self._end_value.gross:  # the profit of the steps ahead already includes the final dry weight
                worth[0] -= sum(float(item.price) * item.factor for item in self._task.ledger.items if item.valued == STOCK)
        return np.concatenate([p.ravel(), worth])
