"""Best known plans: search for plans with perfect information, and check by replay whether one beats another.

``search`` plans scenarios and saves each plan in a small file; ``submit`` replays plans and adopts those that earn more than the best
known ones. See docs/best-known.md. ``dispatch`` finds the least cost of the energy that a run asked for, ``commitment`` that of a way that
keeps the machines' rules, and ``energy_costs`` what buffer and engine earn by it; see docs/energy-dispatch.md.
"""

from glbench.bounds.search import PlanOutcome, PlanValue, Search, agent_controls, group_by_conditions, replay_plans
from glbench.bounds.submitting import PlanComparison, best_known, candidates, repeats_actions, submit

__all__ = [
    "PlanComparison",
    "PlanOutcome",
    "PlanValue",
    "Search",
    "agent_controls",
    "best_known",
    "candidates",
    "group_by_conditions",
    "repeats_actions",
    "replay_plans",
    "submit",
]
