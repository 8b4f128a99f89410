"""Profiles of results: typical day, season, calendar of violations, worst run and hours of the day, kept in one small file.

They are made from what the evaluation simulates anyway. ``docs/report.md`` explains the file.
"""

from glbench.evaluation.profiles.building import load_profile, make_profile, profiled
from glbench.evaluation.profiles.record import Profile, profile_path, read_profile

__all__ = ["Profile", "load_profile", "make_profile", "profile_path", "profiled", "read_profile"]
