"""Best known plans: search for plans with perfect information, and check by replay whether one beats another.

``search`` plans scenarios and saves each plan in a small file; ``submit`` replays plans and adopts those that earn more than the best
known ones. See docs/best-known.md. ``dispatch`` finds the least cost of the energy that a run asked for, and ``energy_costs`` what buffer
and engine earn by it; see docs/energy.md.
"""

from __future__ import annotations

from glbench.bounds.replay import Earned, replayed
from glbench.bounds.search import Found, Search, alike, begun
from glbench.bounds.submitting import Better, best_known, candidates, submit

__all__ = ["Better", "Earned", "Found", "Search", "alike", "begun", "best_known", "candidates", "replayed", "submit"]
