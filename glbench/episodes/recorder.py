"""What a simulation did, kept while it runs, cut into episodes afterwards, and taken again from its recorded actions alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env import Simulation, StepResult, run_weather
from glbench.env.camera import run_scenes
from glbench.env.kernels import Stepper
from glbench.episodes.action_log import ActionLog, exactly
from glbench.episodes.episode import Episode
from glbench.episodes.header import Provenance, RunFacts, definition_json
from glbench.episodes.signals import ACTION, Source, signals_of
from glbench.errors import EpisodeError, did_you_mean, refuse
from glbench.tasks import TaskSpec

LARGEST_TRACE = 512 * 2**20  # Bytes of memory above which no trace is kept: the episodes are then made by replaying


def bytes_a_step(task: TaskSpec) -> int:
    """Bytes of memory that a trace takes for a step of a run of ``task``; about 500 in a greenhouse with tomatoes."""
    return 8 * signals_of(task).width


class Trace:
    """States, controls, climate and quantities of all runs of ``simulation``, from where it stands on.

    ``rows`` chooses runs; by default all. ``bytes_a_step`` tells what it takes.
    """

    def __init__(self, simulation: Simulation, rows: Sequence[int] | None = None) -> None:
        steps, self.rows = simulation.task.steps, tuple(range(simulation.n) if rows is None else rows)
        n, self._subset = len(self.rows), None if rows is None else list(rows)
        self._steps = 0
        self._signals = signals_of(simulation.task)
        self.x = np.empty((steps + 1, n, simulation.x.shape[1]))
        self.air = np.empty((steps + 1, len(simulation.air), n))
        self.u = np.empty((steps, n, simulation.u.shape[1]))
        self.quantities = np.empty((steps, len(self._signals.vector("quantity")), n))
        self.x[0], self.air[0] = self._of(simulation.x, 0), self._of(simulation.air, 1)

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Write down the step that was just taken."""
        step = self._steps
        self.x[step + 1], self.air[step + 1] = self._of(simulation.x, 0), self._of(simulation.air, 1)
        self.u[step], self.quantities[step] = self._of(simulation.u, 0), self._of(outcome.table, 1)
        self._steps += 1

    def _of(self, table: Floats, axis: int) -> Floats:
        """The chosen runs of a table, which lie along ``axis``."""
        return table if self._subset is None else table.take(self._subset, axis=axis)

    def episode(self, task: TaskSpec, row: int, provenance: Provenance, run: RunFacts, actions: NDArray[np.floating]) -> Episode:
        """The episode of the simulation's ``row``, whose raw actions were ``actions`` ``(steps or more, m)``."""
        place, steps = self.rows.index(row), run.steps
        weather = run_weather(task, run.seed)
        acting: dict[Source, Floats] = {"control": self.u[:steps, place], "disturbance": weather.values[:steps]}
        measured: dict[Source, Floats] = {
            "air": self.air[: steps + 1, :, place],
            "state": self.x[: steps + 1, place],
            "clock": weather.hour_of_day[: steps + 1, None],
        }
        measured["derived"] = self._signals.derived({**acting, **measured})
        if task.camera is not None:
            measured["camera"] = run_scenes(task, run.seed, measured["state"], weather.hour_of_day[: steps + 1])[:, None].astype(np.float64)
        from_start = self._signals.tables(measured)
        during = self._signals.tables({**acting, "quantity": self.quantities[:steps, :, place]})
        agent = provenance.agent
        agent_actions = self._signals.in_units(actions[:steps], agent.columns)
        return Episode(
            provenance=provenance,
            run=run,
            definition=definition_json(task),
            groups=self._signals.groups(agent.columns, controls=agent.acts == "controls"),
            tables={ACTION: agent_actions, **during, **{name: values[1:] for name, values in from_start.items()}},
            start={name: values[0] for name, values in from_start.items()},
            times=weather.times[: steps + 1].astype("datetime64[ns]"),
        )


class Recorder:
    """The record of runs in lockstep.

    ``actions`` ``(steps, n, m)`` and ``rewards`` ``(steps, n)`` fill up step by step. ``trace`` holds everything else that full
    episodes show; it is ``None`` when none are wanted, when they would not fit into memory, and after an interruption.
    """

    def __init__(self, simulation: Simulation, columns: int, *, traced: bool) -> None:
        steps, n = simulation.task.steps, simulation.n
        self.actions = np.zeros((steps, n, columns))
        self.rewards = np.zeros((steps, n))
        self._steps = 0
        self._traces = traced and steps * n * bytes_a_step(simulation.task) <= LARGEST_TRACE
        self.trace: Trace | None = None

    def begin(self, simulation: Simulation) -> None:
        """Begin at the start of all runs."""
        if self._traces:
            self.trace = Trace(simulation)

    def add(self, actions: Floats, simulation: Simulation, outcome: StepResult) -> None:
        """Keep the step that was just taken with ``actions`` ``(n, m)``."""
        self.actions[self._steps], self.rewards[self._steps] = actions, outcome.rewards
        self._steps += 1
        if self.trace is not None:
            self.trace.add(simulation, outcome)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a checkpoint has to hold besides the actions, which it holds anyway."""
        return {"step_rewards": self.rewards[: self._steps]}

    def restore(self, arrays: Mapping[str, NDArray[Any]], actions: Floats) -> None:
        """Go on after an interruption, with what the checkpoint holds."""
        self._steps = len(actions)
        self.actions[: self._steps], self.rewards[: self._steps] = actions, arrays["step_rewards"]
        self.trace = None

    def log(self, simulation: Simulation, provenance: Provenance, runs: tuple[RunFacts, ...]) -> ActionLog:
        """The record, once all runs have ended."""
        actions, rewards = self.actions, self.rewards
        for row, run in enumerate(runs):
            actions[run.actions :, row], rewards[run.steps :, row] = 0.0, 0.0
        return ActionLog(provenance, definition_json(simulation.task), runs, exactly(actions), rewards, np.array(simulation.x))


def check_round(task: TaskSpec, provenance: Provenance) -> None:
    """Raises ``EpisodeError`` when a record is of a sealed round and the task is not given that round's secret."""
    recorded, available = provenance.task.salt_commitment, task.salt_commitment
    if recorded == available:
        return
    if recorded is None:
        msg = f"The record has public draws of {task.id}, and not those of the round {available}. Leave --round out."
    elif available is None:
        msg = (
            f"The record belongs to the sealed round {recorded} of {task.id}: only with the secret of the round can its runs be "
            "simulated again. Once it is published: glbench episodes make RESULT --round FILE."
        )
    else:
        msg = f"The record belongs to the round {recorded}, and the secret is that of {available}. Give the file of the right round."
    raise EpisodeError(msg)


class Replay:
    """The runs ``rows`` of ``log`` (by default all), taken again step by step.

    The simulation is that of the evaluation: the same code, the same seeds, the same actions. Raises ``EpisodeError`` when the draws of
    ``task`` are not those of ``log``: one of them is of a sealed round, or they are of two.
    """

    def __init__(self, task: TaskSpec, log: ActionLog, rows: Sequence[int] | None = None, kernel: Stepper | None = None) -> None:
        check_round(task, log.provenance)
        self.rows = tuple(range(len(log.runs)) if rows is None else rows)
        self._log = log
        self._counts = np.array([log.runs[row].actions for row in self.rows])
        self._actions = log.actions[:, list(self.rows)].astype(np.float64)
        self.simulation = Simulation(task, len(self.rows), kernel=kernel)
        self.simulation.reset([log.runs[row].seed for row in self.rows])

    def steps(self) -> Iterator[StepResult]:
        """Take the steps. Before each, the runs that have no further action end where they stand."""
        simulation = self.simulation
        controls = self._log.provenance.agent.acts == "controls"
        for step in range(int(self._counts.max(initial=0))):
            over = self._counts <= step
            if over.any():
                simulation.end(over | simulation.ended)
            if simulation.ended.all():
                return
            take = simulation.step_controls if controls else simulation.step
            yield take(self._actions[step])


def replayed_episodes(task: TaskSpec, log: ActionLog, rows: Sequence[int], kernel: Stepper | None = None) -> Iterator[Episode]:
    """Full episodes of the runs ``rows`` of ``log``, simulated again; ``task`` must be in the split of the record, ``log.task().scored``.

    Raises ``ActionError`` when an action is none of the task's, ``EpisodeError`` when the rewards are other than the record's.
    """
    replay, rewards = Replay(task, log, rows, kernel), list[NDArray[np.float64]]()
    trace = Trace(replay.simulation)
    for outcome in replay.steps():
        trace.add(replay.simulation, outcome)
        rewards.append(outcome.rewards.copy())
    for place, row in enumerate(rows):
        run = log.runs[row]
        if not np.allclose([one[place] for one in rewards[: run.steps]], log.rewards[: run.steps, row], rtol=1e-3, atol=1e-3):
            msg = f"Seed {run.seed} has other rewards than recorded: other seasons. Take the task in its split: log.task().scored."
            raise EpisodeError(msg)
        yield trace.episode(task, place, log.provenance, run, log.actions[: run.steps, row])


WORDS = ("all", "none", "best", "worst", "median")
DEFAULT = "best,worst,median"
ACTIONS_SUFFIX = ".actions.mcap"


def parse_selection(text: str) -> tuple[str, ...]:
    """The words of ``all``, ``none``, or a list such as ``best,worst,median`` or ``best,670`` (a seed).

    Raises ``EpisodeError`` for what is no text, for another word, and for ``all`` or ``none`` in a list.
    """
    if not isinstance(text, str):
        refuse(f"Episodes are chosen by a text such as '{DEFAULT}'; got {text!r}.", EpisodeError)
    words = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    for word in words:
        if word not in WORDS and not word.isdecimal():
            refuse(f"'{word}' chooses no episode.{did_you_mean(word, WORDS)} A run's seed does, too.", EpisodeError)
    if len(words) > 1 and {"all", "none"} & set(words):
        refuse(f"'{text}': all and none stand alone.", EpisodeError)
    return words


def chosen_rows(words: Sequence[str], seeds: Sequence[int], values: Sequence[float]) -> tuple[int, ...]:
    """Places of the chosen runs, in the order of the runs, by their ``values`` (higher is better; of equals the smaller seed).

    Of an even number of runs the median is the lower middle one. Raises ``EpisodeError`` for a seed that is none of the runs'.
    """
    ranked = sorted(range(len(seeds)), key=lambda row: (values[row], -seeds[row]))
    named = {"best": ranked[-1], "worst": ranked[0], "median": ranked[(len(ranked) - 1) // 2]}
    rows: set[int] = set()
    for word in words:
        if word == "all":
            rows.update(range(len(seeds)))
        elif word in named:
            rows.add(named[word])
        elif word != "none":
            if int(word) not in seeds:
                refuse(f"No run has the seed {word}; they have {min(seeds)} to {max(seeds)}.", EpisodeError)
            rows.add(list(seeds).index(int(word)))
    return tuple(sorted(rows))


def actions_path(result: Path) -> Path:
    """``<agent>.actions.mcap`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + ACTIONS_SUFFIX)


def episodes_folder(result: Path) -> Path:
    """Folder of the full episodes of a result.

    ``<out>/episodes/<task>/<agent>`` for a result ``<out>/results/<task>/<agent>.json``; for a result elsewhere a folder beside it.
    """
    name = result.name.removesuffix(".json")
    if result.parent.parent.name == "results":
        return result.parent.parent.parent / "episodes" / result.parent.name / name
    return result.with_name(f"{name}.episodes")


def episode_path(folder: Path, seed: int) -> Path:
    """``<folder>/seed-<seed>.mcap``."""
    return folder / f"seed-{seed}.mcap"
