"""Best known plans: the search for plans of scenarios in which everything is known, and the proof that one is better than another.

``search`` plans scenarios and keeps each in a small file, ``submit`` replays plans and takes those into the best known ones that earn
more. docs/best-known.md tells the whole story.
"""

from __future__ import annotations

from glbench.bounds.replay import Earned, replayed
from glbench.bounds.search import Found, Search, alike, begun
from glbench.bounds.submitting import Better, best_known, candidates, submit

__all__ = ["Better", "Earned", "Found", "Search", "alike", "begun", "best_known", "candidates", "replayed", "submit"]
