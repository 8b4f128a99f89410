"""Puts generated tables into a page of the documentation, each between its two comments."""

from __future__ import annotations

from collections.abc import Mapping

END = "<!-- end -->"


def with_tables(page: str, tables: Mapping[str, str]) -> str:
    """``page`` with each table between ``<!-- name -->`` and the next ``<!-- end -->``.

    Raises
    ------
    ValueError
        When a table has no place, or more than one.
    """
    for name, table in tables.items():
        begin = f"<!-- {name} -->\n"
        before, *after = page.split(begin)
        if len(after) != 1 or END not in after[0]:
            msg = f"The page has {len(after)} places for the table '{name}'; it needs one, between <!-- {name} --> and {END}."
            raise ValueError(msg)
        page = f"{before}{begin}{table}\n{END}{after[0].split(END, 1)[1]}"
    return page
