"""Print the end value of predictive control for the model of a task, as ``baselines/mpc*/settings.yml`` hold it.

    python baselines/end_values.py Spring-v1 my_agent --seeds 20001 20002 20003

Each seed is a season that an agent may be trained on: of a task with splits the training split is taken, and of others a seed that is
scored is refused. The seasons are planned from what the agent does in them, with everything known; one takes a minute or two.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.agents.identity import baseline_names
from glbench.control import EndValue, Scenario, plan_season
from glbench.env import Simulation
from glbench.errors import GlbenchError
from glbench.tasks import TaskSpec, get_task, task_card

SUBMISSIONS = Path(__file__).resolve().parent.parent / "submissions"
log = logging.getLogger("end_values")


def controls_of(agent: str, task: TaskSpec, seed: int) -> NDArray[np.float64]:
    """Controls ``(T, c)`` that an agent sets in a run."""
    loaded = load_agent(agent if agent in baseline_names() else SUBMISSIONS / f"{agent}.py")
    if loaded.sees != "observations":
        msg = f"'{agent}' is privileged: name one that works with observations."
        raise GlbenchError(msg)
    card, simulation, controls = task_card(task), Simulation(task, 1), []
    player = loaded.make(card)
    player.reset(card, 1)  # type: ignore[call-arg, arg-type]
    observations = simulation.reset([seed])
    for _ in range(task.steps):
        observations = simulation.step(player.act(observations)).observations  # type: ignore[union-attr]
        controls.append(simulation.u[0].copy())
    return np.array(controls)


def main() -> None:
    """Plan the seasons, and print what their ends are worth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task")
    parser.add_argument("agent", help="where plans begin: a baseline or an example of submissions/")
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--own", action="store_true", help="for this task alone, because another one has its model and another season")
    parser.add_argument("--stock", metavar="STATE=PRICE", help="what this state is worth at the end of the season [EUR per unit]")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    task, plans = get_task(options.task), []
    task.check_training()
    scored = range(task.evaluation.first_seed, task.evaluation.first_seed + task.evaluation.runs)
    test_seeds = [seed for seed in options.seeds if task.splits is None and seed in scored]
    if test_seeds:
        parser.error(f"seed {test_seeds[0]} of {task.id} is scored: no plan may be made of it")
    for seed in options.seeds:
        start = controls_of(options.agent, task, seed)
        plans.append(plan_season(Scenario.of(task, seed), start, iterations=options.iterations))
        log.info("%s, seed %d: a plan of %.2f", task.id, seed, plans[-1].reward)
    values = {task.id if options.own else task.model_id: EndValue.of_plans(plans).written()}
    if options.stock:
        state, _, price = options.stock.partition("=")
        values[task.id if options.own else task.model_id]["states"][state]["by_days_left"][0] = float(price)
    sys.stdout.write(yaml.safe_dump(values, default_flow_style=None, width=150, sort_keys=False))


if __name__ == "__main__":
    main()
