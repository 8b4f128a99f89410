"""Types of fields in records that may come from elsewhere: bounded numbers and texts."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import AfterValidator, Field

from glbench.untrusted import LARGEST_INTEGER, one_line

LONGEST_TEXT: Final = 2000  # Characters of a text, such as the words that say why a run failed
MOST_ENTRIES: Final = 100  # Entries of a table, such as the metrics of a run

Count = Annotated[int, Field(ge=0, le=LARGEST_INTEGER)]
_Line = Annotated[str, AfterValidator(one_line)]
Word = Annotated[_Line, Field(max_length=300)]
Text = Annotated[_Line, Field(max_length=LONGEST_TEXT)]
