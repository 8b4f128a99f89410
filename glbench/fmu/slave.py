"""The greenhouse as PythonFMU runs it: a ``Simulation`` of one run behind the functions of FMI 2.0.

Everything an importer does wrong (a step that is too short, an input out of bounds, a test season) is said in the importer's log.
"""

from __future__ import annotations

import base64
import contextlib
import logging
import math
from collections.abc import Iterator, Sequence
from copy import copy
from functools import partial
from typing import Any, ClassVar
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pythonfmu
from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability
from pythonfmu.enums import Fmi2Status

from glbench import __version__
from glbench.env import Simulation, Snapshot, info_quantities
from glbench.env.actuation import actions_of
from glbench.errors import ActionError, GlbenchError, ShapeError, refuse
from glbench.fmu.scenario import LARGEST_SEED, FmuSetup, task_in_season
from glbench.fmu.units import base_unit, fmi_unit
from glbench.model import vapour_pressure_deficit
from glbench.quantities import DEFICITS, VIOLATION
from glbench.tasks import Action, TaskSpec
from glbench.tasks.ledger import StepQuantity

_LOG = logging.getLogger(__name__)
_FAILURES: list[object] = []
"""What instances that failed consist of: PythonFMU 0.7.0 releases them once when they fail and once more when they are freed."""
_TIME_TOLERANCE = 1e-6  # Largest deviation of an importer's times from those of the control steps, in steps
_ROUNDING = 1e-6  # An input may be beyond its bounds by this share of its range, and is then taken as the bound
_SAVED = ("_parameters", "_targets", "_initialised", "_start_time", "_numbers", "_totals", "_weather")
"""What the rest of a season depends on, besides the simulation."""
_STEPPED_CONTROLS = ("rate", "set_point")  # Kinds of actuation whose inputs are positions of controls


def fmu_inputs(task: TaskSpec) -> tuple[Action, ...]:
    """The inputs of the FMU of ``task``, each in the unit of what it stands for: positions of controls, or set points."""
    if task.actuation.kind not in _STEPPED_CONTROLS:
        return task.actions
    capacities = {capacity.name: capacity for capacity in task.capacities()}
    inputs = []
    for name in task.actuation.controls:
        one = capacities[name]
        machine, most = task.on_off.get(name), _amount(one.at_one * task.actuation.max_change, one.unit)
        meaning = f"{one.meaning}, as asked for; it changes by at most {most} in a control step"
        if machine is not None:
            half, full = (_amount(one.at_one * share, one.unit) for share in (0.5 * machine.lowest, machine.lowest))
            meaning = f"{one.meaning}, as asked for: off below {half}, else {full} or more"
        installed = one.at_one > 0.0
        stands_for = (0.0, one.at_one) if installed else None
        inputs.append(Action(one.quantity, 0.0, float(installed), one.unit, meaning, 0.0, stands_for))
    return tuple(inputs)


def _amount(value: float, unit: str) -> str:
    return f"{value:g}" if unit == "-" else f"{value:g} {unit}"


class _Real(pythonfmu.Real):  # type: ignore[misc]  # PythonFMU has no types
    """A real variable with unit and bounds, which PythonFMU's own does not write."""

    def __init__(self, name: str, unit: str, low: float | None = None, high: float | None = None, **options: Any) -> None:
        super().__init__(name, **options)
        self.unit, self._bounds = unit, {"min": low, "max": high}

    def to_xml(self) -> Element:
        element: Element = super().to_xml()
        bounds = {name: f"{bound:.16g}" for name, bound in self._bounds.items() if bound is not None}
        element[0].attrib.update({"unit": fmi_unit(self.unit)} if fmi_unit(self.unit) else {}, **bounds)
        return element


class GreenhouseSlave(Fmi2Slave):  # type: ignore[misc]
    """One greenhouse of a task, in any split. A subclass in the FMU states ``setup``, what it was exported with."""

    setup: ClassVar[FmuSetup]

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.task = task = self.setup.find_task()
        self.inputs = fmu_inputs(task)
        self.guid = self.setup.fingerprint[:32]
        self.author, self.version, self.license = "The glbench authors", __version__, "BSD-3-Clause"
        self.description = f"{task.title}: a greenhouse of glbench, task {task.id}"
        self.default_experiment = DefaultExperiment(0.0, task.steps * task.step_seconds, task.step_seconds)
        self._parameters: dict[str, Any] = {"seed": float(self.setup.seed), "split": self.setup.split}
        self._targets = [float(action.value(action.idle)) for action in self.inputs]
        self._added_up = [quantity for quantity in task.quantities if not quantity.name.startswith(VIOLATION)]
        self._simulation: Simulation | None = None
        self._initialised, self._start_time = False, 0.0
        self._numbers: list[float] = []
        self._totals: list[float] = []
        self._weather: list[float] = []
        self._values: list[float] = []
        self._register_variables()

    def _register_variables(self) -> None:
        words = {
            "seed": "selects the season, and what else the run draws: a whole number",
            "split": "training or validation: from which seasons the seed selects; empty in a task without splits",
        }
        for name, text in words.items():
            declare = partial(_Real, unit="-", low=0.0, high=LARGEST_SEED) if name == "seed" else pythonfmu.String
            self.register_variable(
                declare(
                    name, description=text, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed,
                    initial=Fmi2Initial.exact,
                    getter=partial(self._parameters.get, name), setter=partial(self._set_parameter, name),
                )
            )  # fmt: skip
        for place, action in enumerate(self.inputs):
            self.register_variable(
                _Real(
                    f"target.{action.name}", action.unit, action.lowest, action.highest, description=action.meaning,
                    causality=Fmi2Causality.input, variability=Fmi2Variability.discrete,
                    getter=partial(self._targets.__getitem__, place), setter=partial(self._targets.__setitem__, place),
                )
            )  # fmt: skip
        model = self.task.model_value
        name = "vapour_pressure_deficit"
        deficit = StepQuantity(name, DEFICITS[name].unit, "vapour pressure deficit inside, true value")
        groups: list[tuple[str, str, Sequence[Any]]] = [
            ("", "", [*info_quantities(self.task)[1:], *((deficit,) if model.air else ())]),
            ("total.", ", added up since the start", self._added_up),
            ("observed.", ", as an agent observes it", self.task.observed()),
            ("weather.", ", in the coming control step", model.disturbances),
            ("state.", "", model.states),
        ]
        calculated = {"variability": Fmi2Variability.discrete, "initial": Fmi2Initial.calculated}
        variables = [(prefix, suffix, one) for prefix, suffix, quantities in groups for one in quantities]
        for place, (prefix, suffix, one) in enumerate(variables):
            causality = Fmi2Causality.local if prefix == "state." else Fmi2Causality.output
            description = one.meaning + suffix
            self.register_variable(
                _Real(
                    prefix + one.name, one.unit, description=description, causality=causality,
                    getter=partial(self._value, place), **calculated,
                )
            )  # fmt: skip
        description, causality = "whether the season has ended", Fmi2Causality.output
        self.register_variable(
            pythonfmu.Boolean("ended", description=description, causality=causality, getter=lambda: self._running().over == 1, **calculated)
        )  # fmt: skip

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """The model description: PythonFMU's, with units, the digest of the task, and the unknowns of the initialisation."""
        root: Element = super().to_xml(model_options or {})
        root.set("generationTool", f"glbench {__version__} with {root.get('generationTool')}")
        units = Element("UnitDefinitions")
        by_name = {fmi_unit(one.unit): one.unit for one in self.vars.values() if isinstance(one, _Real)}
        for name, unit in sorted(by_name.items()):
            if name:
                element, bases = SubElement(units, "Unit", name=name), base_unit(unit)
                if bases is not None:
                    SubElement(element, "BaseUnit", bases)
        vendor, structure = Element("VendorAnnotations"), root.find("ModelStructure")
        facts = {"id": self.setup.task, "digest": self.setup.digest, "glbench": self.setup.version}
        SubElement(SubElement(vendor, "Tool", name="glbench"), "Task", facts)
        for element, neighbour in ((units, "LogCategories"), (vendor, "ModelVariables")):
            root.insert([child.tag for child in root].index(neighbour), element)
        assert structure is not None
        outputs, unknowns = structure.find("Outputs"), SubElement(structure, "InitialUnknowns")
        assert outputs is not None
        for output in outputs:  # none looks through to an input of the same moment; at the start all follow from seed and split
            SubElement(unknowns, "Unknown", output.attrib, dependencies="1 2")
            output.set("dependencies", "")
        return root

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The season begins at ``start_time`` [s]; the rest changes nothing."""
        with self._failing_safely():
            if not math.isfinite(start_time):
                refuse(f"The season cannot begin at {start_time:g} s. Give a finite start time.", ShapeError)
            self._start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Start the season. From here on seed and split cannot change."""
        self._running()
        self._initialised = True

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Take the control steps of ``step_size`` [s] with the inputs held; false, with the reason in the log, when that cannot be done."""
        with self._failing_safely():
            try:
                self._step(current_time, step_size)
            except GlbenchError as error:
                self._report(str(error), Fmi2Status.discard)
                return False
        return True

    def _report(self, words: str, status: Fmi2Status) -> None:
        """Tell the importer, which listens only when its logging is on, and Python's log, which prints to standard error."""
        self.log(words, status)
        _LOG.warning(words)

    @contextlib.contextmanager
    def _failing_safely(self) -> Iterator[None]:
        """Around what may raise: PythonFMU passes the error on to the importer as fatal."""
        try:
            yield
        except Exception as error:
            _FAILURES.append((self, self.log_queue, type(self)))
            _LOG.error(error)  # in words, without a traceback
            raise

    def _step(self, current_time: float, step_size: float) -> None:
        simulation, task, seconds = self._running(), self.task, self.task.step_seconds
        steps, step = round(step_size / seconds) if np.isfinite(step_size) else 0, int(simulation.k[0])
        if steps < 1 or abs(step_size / seconds - steps) > _TIME_TOLERANCE:
            msg = (
                f"A communication step of {step_size:g} s is not possible: {task.id} is controlled every {seconds:g} s. "
                f"Set the communication step to {seconds:g} s, or to a multiple of it."
            )
            raise ShapeError(msg)
        now = self._start_time + step * seconds
        if simulation.over or step + steps > task.steps:
            rest = 0 if simulation.over else task.steps - step
            msg = (
                f"The season ends before {current_time + step_size:g} s: {rest} control steps of {seconds:g} s are left at {now:g} s. "
                "Stop there, or reset the FMU for another season."
            )
            raise ShapeError(msg)
        if not abs(current_time - now) <= _TIME_TOLERANCE * seconds:  # not a number is refused, too
            msg = f"A step from {current_time:g} s was asked for, but the greenhouse is at {now:g} s. Continue there, or reset the FMU."
            raise ShapeError(msg)
        shares = np.zeros(len(self.inputs))
        for place, (action, value) in enumerate(zip(self.inputs, self._targets, strict=True)):
            room = _ROUNDING * (action.highest - action.lowest)
            if not action.lowest - room <= value <= action.highest + room:
                msg = (
                    f"The input target.{action.name} is {_amount(value, action.unit)}, outside its range {action.lowest:g} to "
                    f"{_amount(action.highest, action.unit)}. Limit it before the step; nothing was simulated."
                )
                raise ActionError(msg)
            shares[place] = action.of(min(max(value, action.lowest), action.highest))
        names, first = task.model_value.control_names, -len(task.quantities)
        moved = [names.index(name) for name in task.actuation.controls]
        rows = []
        for _ in range(steps):
            change = shares
            if task.actuation.kind == "rate":
                target = simulation.commands[0].copy()
                target[moved] = shares
                change = actions_of(task, simulation.commands[0], target)
            _, numbers, ended = simulation.step_single(change)
            rows.append(numbers[first:])
            if not simulation.over:
                self._weather = simulation.d[0].tolist()
            if ended and simulation.result is not None and simulation.result.failed:
                why = f"The season has ended: a control step could not be computed. {simulation.result.failed[0].reason}"
                self._report(why, Fmi2Status.warning)
                break
        for place, quantity in enumerate(task.quantities):
            column = [row[place] for row in rows]
            if not quantity.name.startswith(VIOLATION):
                numbers[first + place] = sum(column)
            elif task.judges_means:
                numbers[first + place] = sum(column) / len(column)
        by_name = dict(zip((quantity.name for quantity in task.quantities), numbers[first:], strict=True))
        self._totals = [total + by_name[one.name] for total, one in zip(self._totals, self._added_up, strict=True)]
        self._numbers = numbers
        self._gather(simulation)

    def _running(self) -> Simulation:
        """The simulation, started when it is first needed."""
        if self._simulation is None:
            seed, split = self._parameters["seed"], self._parameters["split"]
            with self._failing_safely():
                simulation = Simulation(task_in_season(self.task, split, seed), 1)
                simulation.reset([int(seed)])
            self._numbers = [*simulation.info_columns[:, 0].tolist(), *(0.0 for _ in self.task.quantities)]
            self._totals = [0.0 for _ in self._added_up]
            self._weather = simulation.d[0].tolist()
            self._simulation = simulation
            self._gather(simulation)
        return self._simulation

    def _gather(self, simulation: Simulation) -> None:
        """Put the values of all outputs and states together, in the order in which they were registered."""
        air = simulation.air[:, 0].tolist()
        deficit = [float(vapour_pressure_deficit(air[0], air[2]))] if air else []
        observed, states = simulation.observe()[0].tolist(), simulation.x[0].tolist()
        self._values = [*self._numbers, *deficit, *self._totals, *observed, *self._weather, *states]

    def _value(self, place: int) -> float:
        self._running()
        return self._values[place]

    def _set_parameter(self, name: str, value: Any) -> None:
        if self._initialised and value != self._parameters[name]:
            msg = f"The parameter {name} cannot change in a running season. Reset the FMU, then set {name} before its initialisation."
            with self._failing_safely():
                raise GlbenchError(msg)
        self._parameters[name] = value
        if not self._initialised:
            self._simulation = None

    def _get_fmu_state(self) -> dict[str, Any]:
        """All that the rest of the season depends on, as values that JSON can hold."""
        snapshot = b"" if self._simulation is None else self._simulation.snapshot().to_bytes()
        return {**{name: copy(getattr(self, name)) for name in _SAVED}, "snapshot": base64.b64encode(snapshot).decode("ascii")}

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        """Continue from what ``_get_fmu_state`` gave, with the same bits."""
        for own in (self._parameters, self._targets):  # in place: the variables of the FMU refer to them
            own.clear()
        self._parameters.update(state["_parameters"])
        self._targets.extend(state["_targets"])
        self._simulation = None
        if state["snapshot"]:
            with self._failing_safely():
                self._running().restore(Snapshot.from_bytes(base64.b64decode(state["snapshot"])))
        for name in _SAVED[2:]:
            setattr(self, name, copy(state[name]))
        if self._simulation is not None:
            self._gather(self._simulation)
