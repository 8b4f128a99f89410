"""Tables of docs/lettuce.md: ``python -m docs.lettuce_figures [--work runs/design] [--only-page]``.

As docs.greenhouse_design_figures, on seasons of Lettuce-v2: agents of all kinds but predictive control, and blind recordings, one
training year at a time, drawn with salts that no split has.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from docs.benchmark_design_figures import CONSTANT, DOCS, MY_AGENT, NOTHING, PI, Tables, evaluated, write
from docs.greenhouse_design_figures import MEMORY, POLICY, RULES, RUNS, apart_table, jobs, recording_table, year_table

PAGE, FIGURES = DOCS / "lettuce.md", DOCS / "measurements" / "lettuce.json"
ZERO = "rule_based_fair"
"""The controller whose score a lead is counted from: rule_based_unlit is for tomatoes."""
AGENTS = (MEMORY, POLICY, RULES, "rule_based_tuned", "outdoor", MY_AGENT, PI, CONSTANT, ZERO, NOTHING)
ACTING = (MEMORY, "outdoor", MY_AGENT)
SENSIBLE = tuple(Path(agent).stem for agent in AGENTS if agent != NOTHING)


def measure(work: Path, processes: int) -> dict[str, Any]:
    """Score, profit and price of violations of each run [EUR m-2] by year and agent."""
    return {"runs": RUNS, "evaluations": evaluated(jobs("Lettuce-v2", AGENTS, ACTING), work, processes)}


TABLES: Tables = {
    "years": partial(year_table, agents=AGENTS),
    "apart": partial(apart_table, sensible=SENSIBLE),
    "recordings": partial(recording_table, acting=ACTING, zero=ZERO),
}

if __name__ == "__main__":
    write(__doc__, FIGURES, PAGE, TABLES, measure)
