"""Render modes: a panel of text always, pictures with the extra ``video``."""

from __future__ import annotations

import importlib.util
import warnings
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.accounts import EPI
from glbench.env.air import AIR
from glbench.env.history import DailyLightSums, RecentHistory, time_words
from glbench.env.program import air_columns, info_columns
from glbench.errors import GlbenchError, UnknownNameError, refuse
from glbench.model import Air
from glbench.quantities import AIR as LIMITED
from glbench.quantities import VIOLATION, in_sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from glbench.env.picture import Picture
    from glbench.env.simulation import Simulation, StepResult
    from glbench.model import ObservedColumn

TEXT, PICTURES = "ansi", "rgb_array"
RENDER_MODES = (TEXT, PICTURES)
"""Those that there are; ``drawable_modes`` tells which of them can be drawn here."""
FRAMES_PER_SECOND = 24
"""Of a video: a day of 96 steps in 4 s."""

NO_PICTURES = (
    "The render mode 'rgb_array' needs matplotlib, which is not installed: pip install 'glbench[video]'. "
    "Without it the environment works, but cannot be drawn."
)

_CLIMATE, _CROP, _DEFICITS = "indoor_climate", "crop", "vapour_deficit"
"""Observation modules whose quantities the panel shows, of models that have them."""
_OUTSIDE = (("tOut", "air", ".1f"), ("iGlob", "sun", ".0f"), ("wind", "wind", ".1f"))
_CENTS = 100.0


def drawable_modes() -> tuple[str, ...]:
    """Render modes whose packages can be found, without importing them."""
    return RENDER_MODES if importlib.util.find_spec("matplotlib") is not None else (TEXT,)


def checked_render_mode(render_mode: str | None) -> str | None:
    """``render_mode``, with one warning when pictures cannot be drawn. Raises ``UnknownNameError`` when there is no such mode."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        refuse(f"There is no render mode {render_mode!r}. Use {', '.join(map(repr, RENDER_MODES))} or None.", UnknownNameError)
    if render_mode == PICTURES and PICTURES not in drawable_modes():
        _warn_without_matplotlib()
    return render_mode


@cache
def _warn_without_matplotlib() -> None:
    warnings.warn(NO_PICTURES, stacklevel=4)


class Camera:
    """Follows the runs of a simulation and draws them; what it sees changes nothing in them."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._info_part = slice(air_columns(simulation.task).start, info_columns(simulation.task))  # air and controls
        self._light = DailyLightSums(simulation.task)
        self._histories: list[RecentHistory] = []
        self._pictures: dict[int, Picture] = {}  # one a row: what a picture keeps suits the next one of the same run

    def __getstate__(self) -> dict[str, Any]:
        """Without the figures, which are made again when they are needed."""
        return self.__dict__ | {"_pictures": {}}

    def begin(self, rows: Iterable[int] | None = None) -> None:
        """Follow new episodes in ``rows``, by default in all."""
        simulation = self._simulation
        if rows is None:
            rows, self._histories = range(simulation.n), [None] * simulation.n  # type: ignore[list-item]
        for row in rows:
            history = self._histories[row] = RecentHistory(int(simulation.k[row]), simulation.task.step_seconds)
            history.add(simulation.info_columns[self._info_part, row].tolist())
            history.light = self._light.begin(simulation, row)

    def follow_only(self, numbers: Sequence[float], epi: float) -> None:
        """Note a step of the only run, from the numbers of ``Simulation.step_single``."""
        self._histories[0].add(numbers[self._info_part], epi)
        self._histories[0].light = self._light.add(self._histories[0].light, self._simulation, 0)

    def follow(self, result: StepResult, rows: Iterable[int]) -> None:
        """Note the step that ``rows`` have taken."""
        values, epi = self._simulation.info_columns[self._info_part].T.tolist(), result.table[EPI].tolist()
        for row in rows:
            self._histories[row].add(values[row], epi[row])
            self._histories[row].light = self._light.add(self._histories[row].light, self._simulation, row)

    def picture(self, row: int) -> NDArray[np.uint8]:
        """Picture of a run, ``(480, 640, 3)``. Raises ``GlbenchError`` without matplotlib, or before the first reset."""
        if not self._histories:
            refuse("There is nothing to draw yet: call reset first.", GlbenchError)
        if row not in self._pictures:
            try:
                from glbench.env.picture import Picture
            except ModuleNotFoundError as error:
                raise GlbenchError(NO_PICTURES) from error
            self._pictures[row] = Picture(self._simulation.task)
        return self._pictures[row](self._histories[row], self._simulation, row)


def panel(simulation: Simulation, row: int, result: StepResult | None) -> str:
    """What a grower would want to know of one run, in a few lines; ``result`` is its last step, if it took one."""
    task = simulation.task
    model = task.model_value
    time = time_words(simulation.time[row], float(simulation.hour_of_day[row]))
    horizon = task.observation_context().horizon
    modules = {module: model.observed(module, horizon) or () for module in model.observation_modules}
    climate, crop = modules.get(_CLIMATE, ()), modules.get(_CROP, ())
    state = () if climate or crop else next(iter(modules.values()), ())
    places = {entry.name: place for place, entry in enumerate(model.disturbances)}
    weather = ", ".join(
        f"{words} {simulation.d[row, places[name]]:{form}} {model.disturbances[places[name]].unit.replace('°C', 'degC')}"
        for name, words, form in _OUTSIDE
        if name in places
    )
    controls = []
    for capacity, fraction in zip(task.capacities(), simulation.u[row].tolist(), strict=True):
        amount = f"{fraction:.0%}" if capacity.unit == "-" else f"{fraction * capacity.at_one:.3g} {capacity.unit}"
        controls.append(f"{_words(capacity.quantity)} {amount}")
    texts = {
        "inside": _quantities(simulation, row, climate),
        "": _quantities(simulation, row, modules.get(_DEFICITS, ())),
        "outside": weather,
        "controls": ", ".join(controls),
        "crop": _quantities(simulation, row, crop),
        "state": _quantities(simulation, row, state),
        **({} if result is None else _last_step(simulation, result, row)),
    }
    lines = [f"{task.title}: {time}, step {simulation.k[row]} of {task.steps}"]
    return "\n".join([*lines, *(f"  {name:9} {text}" for name, text in texts.items() if text)])


def _quantities(simulation: Simulation, row: int, columns: Sequence[ObservedColumn]) -> str:
    """Quantities that the model observes, in words."""
    task = simulation.task
    model, numbers = task.model_value, simulation.x[row].tolist()
    sources = dict(zip(model.state_names, numbers, strict=True))
    if model.air:
        sources |= dict(zip(AIR, simulation.air[:, row].tolist(), strict=True))

    def value(column: ObservedColumn) -> float:
        if column.of is not None:
            return float(column.of(model.State(*numbers), model.Parameters(*task.parameters().tolist())))
        if column.of_air is not None:
            return float(column.of_air(Air(*simulation.air[:, row].tolist())))
        return float(sources[column.source] * column.factor)

    return ", ".join(f"{_words(column.name)} {value(column):.4g} {column.unit}" for column in columns if column.today is None)


def _words(name: str) -> str:
    return name.replace("_", " ").replace("co2", "CO2")


def _last_step(simulation: Simulation, result: StepResult, row: int) -> dict[str, str]:
    task, quantities = simulation.task, {name: float(values[row]) for name, values in result.quantities.items()}
    earnings, costs = (
        [f"{_plain(item.label or _words(item.name))} {_CENTS * quantities[item.name]:.3f}" for item in side]
        for side in (task.ledger.earned, task.ledger.paid)
    )
    total = " - ".join([" + ".join(earnings) or "0", *costs])
    score = f"reward {quantities['reward']:.3f}"
    if task.scores_money:  # the reward is money, after what violations cost
        violations, money = (_CENTS * quantities[name] for name in ("penalty", "reward"))
        score = f"violations {violations:.3f}, score {money:+.3f}"
    complaints = ", ".join(
        f"{_plain(words['label'])} by {quantities[f'{VIOLATION}{name}_{side}']:.3g} {entry.unit}"
        for name, entry in LIMITED.items()
        for side, words in (("low", entry.below), ("high", entry.above))
        if quantities.get(f"{VIOLATION}{name}_{side}", 0.0) > 0.0
    )
    return {
        "limits": complaints or ("all kept" if task.constraints.items() else ""),
        "this step": f"{_CENTS * quantities['epi']:+.3f} ct m-2 = {total}; {score}",
        "stopped": ", ".join(failure.reason for failure in result.failed if failure.row == row),
    }


def _plain(label: str) -> str:
    """A label in a sentence; terminals may lack the letters of plots."""
    return in_sentence(label.replace("₂", "2"))
