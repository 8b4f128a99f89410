"""Freeze the shipped baselines: their digests, and their actions on recorded inputs.

    python baselines/lock.py           # compare with baselines/lock.toml; exit 1 where something differs
    python baselines/lock.py --write   # add new baselines, and tasks that they have new results of; what is there stays as it is
    python baselines/lock.py --record  # record the inputs again (only for a new task; existing tasks keep theirs)

``lock.toml`` holds, for every baseline, its digest and two numbers for each task that it is recorded on: a weighted sum of its actions
over a day of two runs (six steps for predictive control), and its size. The inputs (what the tuned rules saw, and the true states behind
it) are in ``tests/golden/baseline_inputs.npz``, so the simulation has no part in the comparison. Source may change as long as these
numbers stay. To change the actions of a controller, give it another ``version`` in its ``@controller``, remove its baselines
from the lock, and release their results again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.agents.baselines import shipped_digest
from glbench.agents.identity import baseline_names
from glbench.env import Simulation
from glbench.env.behaviour import Number, weighted_sum
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.runners import PrivilegedRunner, make_runner
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task, task_card

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "baselines" / "lock.toml"
INPUTS = ROOT / "tests" / "golden" / "baseline_inputs.npz"
STEPS, RUNS = 96, 2
TOLERANCE = 1e-9
"""Relative to the sum of magnitudes."""
LIMITS = TimeLimits(start=3600.0, step=600.0)
"""Actions are compared, not times: a busy machine is no reason to fail."""
PLANNERS = {
    "mpc", "mpc_energy", "mpc_energy_hourly", "mpc_greenhouse", "mpc_greenhouse_book", "mpc_lettuce", "mpc_scenario_lettuce",
    "mpc_true_state", "mpc_value_lettuce",
}  # fmt: skip
PLANNER_STEPS, PLANNER_TOLERANCE, OTHER_PROCESSOR = 6, 1e-3, 3e-2
"""For predictive control. Each step starts from the plan of the last one, so rounding of 1e-15 grows to 1e-2 within half a day. The
third is for processors of another kind than the recorded one."""
DRIVERS = {
    "Schiphol2010-Delta10-v1": "rule_based_tuned",
    "Spring-v1": "rule_based_tuned",
    "Lettuce-v1": "rule_based_tuned",
    "WinterLED-v1": "rule_based_energy",
    "SpringEnergy-v1": "rule_based_energy",
    "FullSeasonEnergy-v1": "rule_based_energy",
    "GreenhouseReal-v1": "rule_based_tuned",
    "LettuceHarvest-v1": "rule_based_harvest",
    "tests/golden/lettuceclassic.toml": "rule_based_lettuce",
    "tasks/drafts/springsetpoints-v1.toml": "grower",
}
"""The tasks that inputs are recorded on, and the baseline that drives the recorded runs."""
STANDS_FOR = {"tests/golden/lettuceclassic.toml": "LettuceClassic-Delta05-v1"}
"""Published tasks whose weather glbench may not ship, by the task in other weather that is recorded in their place."""
GROW = (
    "best_known", "mpc_energy", "mpc_greenhouse", "outdoor", "ppo_energy", "ppo_greenhouse", "ppo_memory_greenhouse",
    "rule_based_greenhouse", "sac_fast",
)  # fmt: skip
"""These, and further trainings of them, get plans, policies, pages or end values for more tasks, and with them another digest.
``earlier`` in an entry are the digests of the results that are released."""
_HEADER = """\
# What the shipped baselines are and do, written by `python baselines/lock.py --write` and compared by the tests.
# Entries are added, never edited.
# `actions`: weighted sum of the actions on a day of recorded inputs, and the same sum over their magnitudes.
"""


_RELEASE = "python baselines/release.py --work FOLDER --only NAME --task TASK"


def task_of(name: str) -> TaskSpec:
    """The test split of a task in ``DRIVERS``."""
    return get_task(ROOT / name if name.endswith(".toml") else name).scored


def tasks_of(baseline: str) -> list[str]:
    """Tasks of ``DRIVERS`` for which a baseline has released results, or whose inputs it recorded."""
    results = ROOT / "reports" / "released" / "results"
    return [
        name
        for name, driver in DRIVERS.items()
        if driver == baseline or any(results.glob(f"*{STANDS_FOR.get(name, name)}*/{baseline}.json"))
    ]


def record(name: str) -> dict[str, NDArray[Any]]:
    """Inputs of a day by what a controller sees, each ``(steps, runs, columns)``."""
    task = task_of(name)
    seeds, card = task.evaluation.seeds[:RUNS], task_card(task)
    simulation = Simulation(task, RUNS)
    observations = simulation.reset(seeds)
    driver = make_runner(load_agent(DRIVERS[name]), task, card, seeds, LIMITS)
    driver.start()
    privileged = PrivilegedRunner(None, task, card, RUNS, LIMITS)  # type: ignore[arg-type]
    inputs: dict[str, list[NDArray[Any]]] = {"observations": [], "state": [], "scenario": []}
    for step in range(STEPS):
        inputs["observations"].append(observations.copy())
        inputs["state"].append(privileged.inputs(simulation, observations))
        inputs["scenario"].append(np.array(simulation.x))
        decision = driver.decide(step, driver.inputs(simulation, observations), np.ones(RUNS, dtype=bool))
        observations = driver.apply(simulation, decision.actions).observations
    return {f"{name}.{sight}": np.stack(rows) for sight, rows in inputs.items()}


def actions_of(baseline: str, name: str, inputs: NDArray[Any]) -> Number:
    """Weighted sum of a baseline's actions on recorded inputs ``(steps, runs, columns)``, and that of their magnitudes."""
    task = task_of(name)
    runner = make_runner(load_agent(baseline), task, task_card(task), task.evaluation.seeds[:RUNS], LIMITS)
    failures = list(runner.start())
    rows = []
    for step, columns in enumerate(inputs[:PLANNER_STEPS] if baseline in PLANNERS else inputs):
        decision = runner.decide(step, columns, np.ones(RUNS, dtype=bool))
        failures += decision.failures
        rows.append(decision.actions)
    if failures:
        msg = f"{baseline} failed on {name}: {failures[0].reason}"
        raise RuntimeError(msg)
    return weighted_sum(np.stack(rows).ravel())


def behaviour(baseline: str, but: Container[str] = ()) -> dict[str, Number]:
    """The two numbers of every task that the baseline is recorded on, without the tasks in ``but``."""
    sight = load_agent(baseline).sees
    with np.load(INPUTS) as archive:
        return {name: actions_of(baseline, name, archive[f"{name}.{sight}"]) for name in tasks_of(baseline) if name not in but}


def read_lock() -> dict[str, dict[str, Any]]:
    """Entries of the lock by the baseline's name."""
    return tomllib.loads(LOCK.read_text(encoding="utf-8")) if LOCK.is_file() else {}


def digests_of(entry: dict[str, Any]) -> list[str]:
    """The digests that released results of a baseline may have."""
    return [entry["digest"], *entry.get("earlier", [])]


def is_recorded_processor() -> bool:
    """Whether this processor is of the kind that the lock was recorded on: x86 with AVX-512. Elsewhere, rounding differs."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    return any(name == "X86_V4" or name.startswith("AVX512") for name in extensions)


def problems_of(baseline: str, entry: dict[str, Any]) -> list[str]:
    """How a baseline differs from its entry in the lock, in words."""
    digest = shipped_digest(baseline)
    problems = [] if digest == entry["digest"] else [f"{baseline}: digest {digest}, locked {entry['digest']}"]
    numbers = behaviour(baseline)
    planner = PLANNER_TOLERANCE if is_recorded_processor() else OTHER_PROCESSOR
    tolerance = planner if baseline in PLANNERS else TOLERANCE
    for name, (value, size) in entry["actions"].items():
        if name not in numbers:
            problems.append(f"{baseline}: no longer recorded on {name}")
        elif not abs(numbers[name].value - value) <= tolerance * size:
            problems.append(f"{baseline}: other actions on {name}: {numbers[name].value:.12g}, locked {value:.12g}")
    return problems


def main() -> int:
    """Compare the shipped baselines with the lock, or write what is new."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="add baselines that have no entry, and tasks that an entry lacks")
    parser.add_argument("--record", action="store_true", help="record inputs of tasks that have none")
    options = parser.parse_args()
    if options.record:
        archive = dict(np.load(INPUTS)) if INPUTS.is_file() else {}
        for name in DRIVERS:
            if f"{name}.state" not in archive:
                archive |= record(name)
        np.savez_compressed(INPUTS, **archive)
    entries = read_lock()
    if options.write:
        for baseline in baseline_names():
            actions = entries.get(baseline, {}).get("actions", {})
            actions |= {name: list(number) for name, number in behaviour(baseline, but=actions).items()}
            if not actions:
                print(f"{baseline}: not locked, as it has no released results. Commit it and make them first: {_RELEASE}")
                continue
            digest = shipped_digest(baseline)
            entry = entries.get(baseline, {"digest": digest})
            if baseline.partition("_seed")[0] in GROW and digest != entry["digest"]:
                entry = {"digest": digest, "earlier": [entry["digest"], *entry.get("earlier", [])]}
            entries[baseline] = entry | {"actions": actions}
        blocks = [
            f'[{name}]\ndigest = "{entries[name]["digest"]}"\n'
            + (f"earlier = {json.dumps(entries[name]['earlier'])}\n" if "earlier" in entries[name] else "")
            + f"\n[{name}.actions]\n"
            + "".join(f'"{task}" = [{value!r}, {size!r}]\n' for task, (value, size) in entries[name]["actions"].items())
            for name in sorted(entries)
        ]
        write_atomically(LOCK, "\n".join([_HEADER, *blocks]))
    problems = [f"{name}: not locked" for name in baseline_names() if name not in entries]
    problems += [text for name, entry in entries.items() for text in problems_of(name, entry)]
    for text in problems:
        print(text)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
