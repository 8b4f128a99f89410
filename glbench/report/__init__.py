"""The report: one page, made from stored results alone, that works offline, on a phone, in light and dark.

``write_report(out)`` makes ``<out>/index.html``; ``docs/report.md`` says what it shows and what it rests on.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.report.page import Completion, Report, build_report, complete_profiles, write_report
else:
    __getattr__ = lazy_names(__name__)

__all__ = ["Completion", "Report", "build_report", "complete_profiles", "write_report"]
