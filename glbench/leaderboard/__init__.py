"""Statistics over runs, ranking of agents, and leaderboard tables. Nothing in here simulates."""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.leaderboard.collect import Expectation, StoredResult, collect_readable, collect_results
    from glbench.leaderboard.ranking import Row, TaskTable, rank
    from glbench.leaderboard.statistics import Estimate, bootstrap_interval, estimate, estimates_of, interquartile_mean, mean
    from glbench.leaderboard.tables import to_frame, to_markdown, write_leaderboard
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "Estimate", "Expectation", "Row", "StoredResult", "TaskTable", "bootstrap_interval", "collect_readable", "collect_results",
    "estimate", "estimates_of", "interquartile_mean", "mean", "rank", "to_frame", "to_markdown", "write_leaderboard",
]  # fmt: skip
