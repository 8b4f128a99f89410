"""The table of parameters in compartment.md: ``python -m docs.compartment_table``."""

from __future__ import annotations

from pathlib import Path

from docs.tables import with_tables
from glbench.model import COMPARTMENT
from glbench.model.compartment import MEASURED

PAGE = Path(__file__).with_name("compartment.md")


def filled(page: str) -> str:
    """The page with the parameters that a compartment has besides the tomato greenhouse."""
    lines = [f"| parameter | unit | meaning | benchmark | `{MEASURED}` | source |", "|---|---|---|---:|---:|---|"]
    for info in COMPARTMENT.table:
        if info.group == "compartment":
            values = " | ".join(f"{info.values[name]:g}" for name in ("benchmark", MEASURED))
            source = info.source.replace("docs/realism.md", "[realism.md](realism.md)")
            lines.append(f"| `{info.name}` | {info.unit} | {info.meaning} | {values} | {source} |")
    return with_tables(page, {"parameters": "\n".join(lines)})


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
