"""Extended Kalman filter that estimates states, parameters and sensor errors from observations.

A run is not quite the nominal model, and its task says by how much: parameters and start are drawn, sensors are off. All of it is public,
and makes the filter's covariances; nothing is left to tune but a small error of the model itself.

The filter estimates, for every run,

- the states x, stepped by the kernel with its Jacobians;
- the relative deviation of every parameter that the task draws for the episode, and of those that it draws daily, which are forgotten
  within a day; of a ``Spread``, whose houses lie far apart, the logarithm;
- how far an unseen column of the weather is off (``UNSEEN``), which is forgotten within hours, and how far one is whose sensor errs,
  which stays for the run;
- how far what an actuator delivers is off from what it would without faults, which is forgotten in the mean time of a fault;
- bias and drift of every sensor: a reading is truth + noise + bias + drift k / N in step k of N, as ``glbench.env.air`` makes it.

Parameters redrawn in each step are noise on the states along the derivatives of the step. A reading that is exactly the last one
comes from a sensor that hangs, or is a sample that is still shown, and is left out; so is one that is missing (NaN). Measured columns are
taken one after the other in Joseph's form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from glbench.arrays import Floats
from glbench.control.delivery import Delivery, ExpectedDelivery
from glbench.control.observation_model import ObservationModel, checked_observations, refuse_missing
from glbench.env.air import Sensors
from glbench.env.memory_layout import DrawPlaces
from glbench.env.outdoor import OutdoorSensors
from glbench.env.spaces import the_task
from glbench.env.uncertainty import DISTRIBUTIONS, DerivedParameters
from glbench.errors import ShapeError, StepError, TaskError, refuse, whole_number
from glbench.kernel import Kernel
from glbench.tasks import TaskSpec
from glbench.tasks.resolver import ParameterGroup

UNSEEN = {"tSky": (6.0, 4.0)}
"""Standard deviation [its unit] of what ``Outlook`` says of a column of the weather that nobody sees, and the hours in which the error
fades to 1/e."""
MODEL_ERROR = 3e-4
"""Standard deviation of the error that a step makes in each state, as a share of the state's size."""
START_ERROR = 5e-3
"""The same of the start, for states whose start the task does not draw."""
STEEP = 100.0
"""Derivatives of a state by a control above so many times its size are left out: for a screen that is not drawn they have no bound."""
ROUNDING = 2.0**-22
"""Relative standard deviation of a column that is observed as it is: the rounding of float32, four times."""
_A_DAY = 24.0
"""Hours in which a parameter that is drawn daily is forgotten to 1/e."""
_EVER = 1e4
"""Time constant [h] with which the estimate of a parameter drawn for the episode returns to its mean, so that errors fade."""
_SMALL = 1e-4
_GRID: Floats = np.asarray((np.arange(4096) + 0.5) / 4096.0, np.float64)


class StateEstimator:
    """Estimates the states of runs of a task from their observations, step by step.

    It knows what its agent knows: the task, observations and the weather of the step just past. It works inside the sandbox. A new one
    is ready for one run, as after ``reset(1)``.

        outlook, estimator = Outlook(task, climatology), StateEstimator(task)
        outlook.reset(n), estimator.reset(n)
        ... in every call of ``act(observations)``:
        outlook.update(observations)
        states = estimator.update(observations, outlook.past)

    Raises ``TaskError`` when the task shows nothing of its states.

    ``preset`` is that of the kernel. ``parameters``: whether to estimate parameters that the task draws for the episode; without, their
    deviations act as noise of the states. ``restart``: whether a run whose step fails starts over from what the nominal model made of the
    weather and the controls so far, as one does whose estimate is no longer finite; without, it stays where it is.

    After an update ``states`` are the estimates ``(n, s)``, ``deviations`` their standard deviations by the filter's own account
    ``(n, s)``, and ``parameters`` the parameters ``(n, p)`` as estimated, derived ones made to fit; nominal where the task draws none.
    """

    def __init__(self, task: TaskSpec | str, *, preset: str = "fast", parameters: bool = True, restart: bool = False) -> None:
        self.task = task = the_task(task)
        self._restarts = restart
        self._model = ObservationModel(task)
        if not self._model.names:
            refuse(f"{task.id} shows nothing of the states of its model: there is nothing to estimate them from.", TaskError)
        model = task.model_value
        self.kernel = Kernel(model, task.step_seconds, preset=preset)
        self.kernel.prepare(task.parameters())  # now, and not within the time of the first decision
        self._s, self._names = len(model.states), [column.name for column in task.observed()]
        self._nominal = task.parameters()
        groups = [group for group in task.scenario.groups if group.half_width > 0.0]
        self._episode = _UncertainParameters(task, [group for group in groups if parameters and group.redraw != "step"])
        self._by_step = _UncertainParameters(task, [group for group in groups if not parameters or group.redraw == "step"])
        self._delivery = ExpectedDelivery(task)
        weather = {name: (*error, False) for name, error in UNSEEN.items()}
        weather |= {name: (spread, _EVER, scaled) for name, (spread, scaled) in OutdoorSensors.of(task, DrawPlaces()).spreads.items()}
        wrong = {name: weather[name] for name in model.disturbance_names if name in weather}
        self._wrong = [model.disturbance_names.index(name) for name in wrong]
        self._scaled = np.array([scaled for _, _, scaled in wrong.values()], np.bool_)
        self._sensors = Sensors.of(task)
        hours, count = task.step_seconds / 3600.0, len(self._sensors.sensors)
        offsets = [(one.bias, one.drift / np.sqrt(3.0)) for one in self._sensors.sensors]
        # Of everything but the states: standard deviation at the start, and what is left of it after a step.
        self._first = np.array(
            [
                *self._episode.spread,
                *(spread for spread, _, _ in wrong.values()),
                *self._delivery.spread,
                *(size for pair in offsets for size in pair),
            ]
        )
        self._fading = np.exp(
            -hours
            / np.array([*self._episode.hours, *(fading for _, fading, _ in wrong.values()), *self._delivery.hours, *([np.inf] * 2 * count)])
        )
        self._places = np.cumsum([self._s, len(self._episode.spread), len(wrong), len(self._delivery.places), 2 * count])
        self._start_spread = _start_spread(task)
        self.reset(1)

    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs."""
        self._n, self._step = whole_number(n, "The number of runs"), 0
        self._z = np.zeros((self._n, int(self._places[-1])))
        self._covariance = np.zeros((self._n, 0, 0))
        self._last = np.full((self._n, len(self._model.names)), np.nan)
        self._delivery.reset(self._n)
        self._u = self._commands = np.tile(self.task.initial_controls, (self._n, 1))

    @property
    def states(self) -> Floats:
        """Estimates ``(n, s)`` after the last update."""
        return self._z[:, : self._s].copy()

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the states by the filter's own account ``(n, s)``."""
        spread: Floats = np.sqrt(np.maximum(np.diagonal(self._covariance, axis1=1, axis2=2)[:, : self._s], 0.0))
        deviations: Floats = spread * self._scale[:, : self._s]
        return deviations

    @property
    def controls(self) -> Floats:
        """Controls ``(n, c)`` as delivered in the step just past: those in force, corrected by what is found of actuators."""
        u, places, errors = self._u.copy(), self._delivery.places, self._z[:, self._places[2] : self._places[3]]
        u[:, places] = np.clip(u[:, places] + errors, 0.0, 1.0)
        return u

    def delivery(self, steps: int) -> Delivery | None:
        """What actuators are expected to deliver of the commands of the coming steps; ``None`` where all are ideal."""
        places = self._delivery.places
        if not places:
            return None
        lasting = np.ones((whole_number(steps, "The number of steps ahead"), self._u.shape[1]))
        lasting[:, places] = self._fading[self._places[2] - self._s : self._places[3] - self._s] ** np.arange(1, steps + 1)[:, None]
        return Delivery.ahead(self.controls, self._commands, lasting)

    @property
    def parameters(self) -> Floats:
        """Parameters as estimated ``(n, p)``: nominal where the task draws none, derived ones made to fit."""
        return self._episode.complete(self._z[:, self._s : self._places[1]])

    def weather_errors(self, steps: int, ahead: Floats | None = None) -> Floats:
        """How far the weather of the coming steps is expected to be off ``(n, steps, d)``; to be added to ``Outlook.ahead(steps).d``.

        Columns that nobody sees are (``UNSEEN``): by as much as is estimated now, and less with every hour. So are those whose sensors
        err; of a sensor that is off by a factor, the error is a share of the disturbances ``ahead`` ``(n, steps, d)``, and 0 without them.
        """
        count = whole_number(steps, "The number of steps ahead")
        start, end = int(self._places[1]), int(self._places[2])
        errors = np.zeros((self._n, count, len(self.task.model_value.disturbances)))
        fading = self._fading[start - self._s : end - self._s] ** np.arange(count)[:, None]
        errors[:, :, self._wrong] = self._z[:, None, start:end] * fading
        if self._scaled.any():
            errors[:, :, self._wrong] *= np.where(self._scaled, 0.0 if ahead is None else ahead[:, :, self._wrong], 1.0)
        return errors

    def update(self, observations: ArrayLike, d: ArrayLike, controls: ArrayLike | None = None) -> Floats:
        """Take in what is observed now; once at the start, before the first action, and once after every step.

        Raises ``TaskError`` when observations have the wrong shape, a reading is infinite, or controls are neither given nor shown. Raises
        ``ShapeError`` when the disturbances have the wrong shape, as ``Outlook.past`` has before its first update.

        ``observations`` are ``(n, columns)``, as an agent gets them; a reading that is NaN is missing: it is left out for its run. ``d``
        are the disturbances ``(n, d)`` of the step just past; at the first call those of the step to come, from which the start follows:
        ``Outlook.past`` is both. ``controls`` are those in force in the step just past ``(n, c)``, fractions; read from the observations
        where the task shows them. Scheduled ones are those of the calendar (``with_schedule``). Returns the states ``(n, s)``, a new array.
        """
        task, n = self.task, self._n
        readings = checked_observations(task, observations, n, self._names)
        d, expected = np.array(d, dtype=np.float64), (n, len(task.model_value.disturbance_names))
        if d.shape != expected:
            first = "call outlook.update(observations) first" if d.size == 0 else "a row for each run"
            refuse(f"Wrong shape of the disturbances of {task.id}: expected {expected}, got {d.shape}; {first}.", ShapeError)
        if self._covariance.shape[1] == 0:
            self._start(d)
        else:
            if controls is not None:
                u = np.array(controls, dtype=np.float64)
            elif self._model.control_columns is None:
                refuse(f"{task.id} does not show its controls: say which were in force, controls=...", TaskError)
            else:
                why = "Say which controls were in force: controls=..."
                refuse_missing(readings, self._model.control_columns, task, self._names, why)
                u = self._model.controls(readings)
            self._predict(d, u)
            self._step += 1
        self._correct(readings[:, self._model.columns])
        return self.states

    def _start(self, d: Floats) -> None:
        """The nominal start, and how far a run may be from it."""
        s = self._s
        self._z[:, :s] = [self.task.start_state(row) for row in d]
        size = np.abs(self._z[:, :s])
        size = np.where(size > 0.0, size, 1.0)
        self._scale = np.concatenate([size, np.tile(np.where(self._first > 0.0, self._first, 1.0), (self._n, 1))], axis=1)
        spread = np.concatenate([np.tile(self._start_spread, (self._n, 1)), (self._first > 0.0) * np.ones_like(self._scale[:, s:])], axis=1)
        self._covariance = spread[:, :, None] ** 2 * np.eye(spread.shape[1])
        self._uncorrected, self._at_start = self._z[:, :s].copy(), self._covariance.copy()

    def _predict(self, d: Floats, u: Floats) -> None:
        """A step of the model, and of the covariance along its derivatives; in units of ``self._scale``."""
        s, (_, of_weather, of_delivery, of_sensors, _) = self._s, self._places.tolist()
        p = self.parameters
        as_measured = d.copy()
        size = np.where(self._scaled, d[:, self._wrong], 1.0)
        d[:, self._wrong] += self._z[:, of_weather:of_delivery] * size
        places, self._u, self._commands = self._delivery.places, self._delivery(u, d), u
        self._uncorrected, _ = self.kernel.try_step(self._uncorrected, np.clip(self._u, 0.0, 1.0), as_measured, self._nominal)
        u = self.controls
        x_next, dx, du, dd, dp = self._linearise(self._z[:, :s], u, d, p)
        forward = np.zeros((self._n, s, self._z.shape[1]))
        forward[:, :, :s] = dx
        forward[:, :, s:of_weather] = self._episode.along(dp[:, :, : len(self._episode.names)], self._z[:, s:of_weather])
        forward[:, :, of_weather:of_delivery] = dd[:, :, self._wrong] * size[:, None]
        slopes = du[:, :, places]
        forward[:, :, of_delivery:of_sensors] = np.where(np.abs(slopes) <= STEEP * self._scale[:, :s, None], slopes, 0.0)
        forward *= self._scale[:, None, :] / self._scale[:, :s, None]
        self._z[:, :s] = x_next
        self._z[:, s:] *= self._fading
        # The lower part of the transition is diagonal: what fades, and what stays.
        old = self._covariance
        upper = forward @ old
        new = np.empty_like(old)
        new[:, :s, :s] = upper @ forward.transpose(0, 2, 1)
        new[:, :s, s:] = upper[:, :, s:] * self._fading
        new[:, s:, :s] = new[:, :s, s:].transpose(0, 2, 1)
        new[:, s:, s:] = old[:, s:, s:] * (self._fading[:, None] * self._fading)
        if self._by_step.names:
            gusts = dp[:, :, len(self._episode.names) :] @ (self._by_step.chain * self._by_step.spread)
            gusts /= self._scale[:, :s, None]
            new[:, :s, :s] += gusts @ gusts.transpose(0, 2, 1)
        diagonal = np.arange(new.shape[1])
        new[:, diagonal[:s], diagonal[:s]] += MODEL_ERROR**2
        new[:, diagonal[s:], diagonal[s:]] += (self._first > 0.0) * (1.0 - self._fading**2)
        self._covariance = new
        self._restart()

    def _restart(self) -> None:
        """Let runs whose estimate is no longer finite start over."""
        lost = ~np.isfinite(self._z).all(axis=1)
        if lost.any():
            self._z[lost] = 0.0
            self._z[lost, : self._s] = self._uncorrected[lost]
            self._covariance[lost] = self._at_start[lost]

    def _linearise(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, ...]:
        """States after a step and their derivatives; a run whose step fails stays where it is, or is lost."""
        names = (*self._episode.names, *self._by_step.names)
        inputs = ("x", *("u" for _ in self._delivery.places[:1]), *("d" for _ in self._wrong[:1]))
        try:
            step = self.kernel.linearise(x, u, d, p, inputs=inputs, parameters=names)
        except StepError:
            if len(x) > 1:
                rows = [self._linearise(*(values[row : row + 1] for values in (x, u, d, p))) for row in range(len(x))]
                return tuple(np.concatenate(parts) for parts in zip(*rows, strict=True))
            widths = (u.shape[1] if "u" in inputs else 0, d.shape[1] if "d" in inputs else 0, len(names))
            return (
                np.full_like(x, np.nan) if self._restarts else x.copy(),
                np.eye(self._s)[None],
                *(np.zeros((1, self._s, width)) for width in widths),
            )
        return step.x_next, step.dx, step.du, step.dd, step.dp

    def _correct(self, readings: Floats) -> None:
        """Take in the readings one after the other, as functions of the states linearised around the prediction."""
        around = z = self._z
        cov, s, first = self._covariance, self._s, int(self._places[3])
        values, slopes = self._model.of(around[:, :s])
        elapsed, gaps = self._step / self.task.steps, np.isnan(readings)
        for place, sensor in enumerate(self._model.sensor.tolist()):
            reading, expected, missing = readings[:, place], values[:, place], gaps[:, place]
            row = np.zeros_like(z)
            row[:, :s] = slopes[:, place]
            reading = np.where(missing, expected, reading)
            noise = (ROUNDING * np.maximum(np.abs(reading), ROUNDING)) ** 2
            use = (~missing).astype(np.float64)
            if sensor >= 0:
                noise = noise + self._sensors.sensors[sensor].noise ** 2
                at = first + 2 * sensor
                row[:, at], row[:, at + 1] = 1.0, elapsed
                expected = expected + around[:, at] + elapsed * around[:, at + 1]
                if self._sensors.out > 0.0:  # what hangs shows its last reading, to the bit
                    use *= reading != self._last[:, place]
            sample = self._model.samples[place]
            if sample is not None:  # between two samples the last one is shown
                noise = noise + (sample.noise * reading) ** 2
                use *= reading != self._last[:, place]
            surprise = reading - expected - (row * (z - around)).sum(axis=1)
            row *= self._scale
            along = (cov * row[:, None, :]).sum(axis=2)
            gain = along * (use / ((along * row).sum(axis=1) + noise))[:, None]
            z = z + gain * surprise[:, None] * self._scale
            # Joseph: (1 - K h) P (1 - K h)' + K R K'.
            cov = cov - gain[:, :, None] * along[:, None, :]
            after = (cov * row[:, None, :]).sum(axis=2)
            cov = cov - after[:, :, None] * gain[:, None, :] + (noise[:, None] * gain)[:, :, None] * gain[:, None, :]
        self._covariance = 0.5 * (cov + cov.transpose(0, 2, 1))
        of_parameters = slice(s, int(self._places[1]))
        z[:, of_parameters] = np.clip(z[:, of_parameters], self._episode.low, self._episode.high)
        self._z, self._last = z, np.where(gaps, self._last, readings)
        self._restart()


class _UncertainParameters:
    """Parameters that a task draws, by deviations with a spread: one for every parameter, or for every number that a ``Spread`` draws.

    A parameter is its nominal value times 1 + its deviation; of a ``Spread``, its own times exp(size deviation), with standard deviation 1.

    ``names`` are the parameters that change with them, derived ones among them; ``chain`` is how, where all deviations are 0: derivatives
    of the parameters by the deviations ``(names, deviations)``. ``spread``, ``low``, ``high`` and ``hours`` are the standard deviation of
    each deviation, its limits, and the hours in which it is forgotten to 1/e.
    """

    def __init__(self, task: TaskSpec, groups: list[ParameterGroup]) -> None:
        model, self._nominal = task.model_value, task.parameters()
        rows: list[tuple[str, int, float]] = []  # a parameter, the place of its deviation, the size of its logarithm or 0
        ranges: list[tuple[float, float, float, float]] = []
        for group in groups:
            hours = _EVER if group.redraw == "episode" else _A_DAY
            if group.spread is None:
                grid = DISTRIBUTIONS[group.distribution](_GRID, group.half_width)
                farthest = float(np.max(np.abs(grid)))
                rows += [(name, len(ranges) + place, 0.0) for place, name in enumerate(group.parameters)]
                ranges += [(float(np.std(grid)), -farthest, farthest, hours)] * len(group.parameters)
                continue
            limits = group.spread.limits()
            for draw in dict.fromkeys(row.draw for row in group.spread.rows):
                sizes = {row.parameter: group.spread.factor * row.log_sd for row in group.spread.rows if row.draw == draw}
                low, high = np.array([np.log(limits[name]) / size for name, size in sizes.items()]).T
                rows += [(name, len(ranges), size) for name, size in sizes.items()]
                ranges.append((1.0, float(np.max(low)), float(np.min(high)), hours))
        self._places = [model.parameter_names.index(name) for name, _, _ in rows]
        self._deviation, self._sizes = np.array([place for _, place, _ in rows], np.intp), np.array([size for *_, size in rows])
        self._derived = DerivedParameters(model, self._nominal, tuple(self._places))
        self.spread, self.low, self.high, hours_of = np.array(ranges).reshape(-1, 4).T
        self.hours = hours_of.tolist()
        changed = sorted({*self._places, *self._derived.followers})
        self.names = tuple(model.parameter_names[place] for place in changed)
        steps = _SMALL * np.eye(len(ranges))
        ahead, behind = self.complete(steps), self.complete(-steps)
        self.chain: Floats = np.ascontiguousarray(((ahead - behind) / (2.0 * _SMALL))[:, changed].T)

    def along(self, slopes: Floats, deviations: Floats) -> Floats:
        """Derivatives ``(n, ..., deviations)`` at ``deviations``, from those by the parameters of ``names``."""
        forward: Floats = slopes @ self.chain
        if self._sizes.any():  # a parameter of a spread, and what is derived of it in proportion, changes by a share of itself
            growth = np.ones((len(deviations), len(self.spread)))
            growth[:, self._deviation] = np.where(self._sizes > 0.0, self._multipliers(deviations), 1.0)
            forward *= growth[:, None]
        return forward

    def complete(self, deviations: Floats) -> Floats:
        """All parameters ``(n, p)`` with ``deviations`` ``(n, deviations)``."""
        parameters = np.tile(self._nominal, (len(deviations), 1))
        if self._places:
            parameters[:, self._places] *= self._multipliers(deviations)
            self._derived.complete(parameters)
        return parameters

    def _multipliers(self, deviations: Floats) -> Floats:
        """By what each drawn parameter is multiplied ``(n, parameters)``."""
        own = deviations[:, self._deviation]
        return np.where(self._sizes > 0.0, np.exp(self._sizes * own), 1.0 + own)


def _start_spread(task: TaskSpec) -> Floats:
    """Relative standard deviations of the states at the start."""
    spread = np.full(len(task.model_value.states), START_ERROR)
    for group in task.scenario.start_groups:
        of_group = float(np.std(DISTRIBUTIONS[group.distribution](_GRID, group.half_width)))
        for name in group.states:
            spread[task.model_value.state_index(name)] = np.hypot(of_group, START_ERROR)
    return spread
