"""Pages made of executed notebooks: text as it is, code in blocks, and below it what it gave."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any


def page_of(notebook: Path, page: Path) -> str:
    """Text of the page of a notebook; pictures are written into the folder of the same name beside ``page``."""
    parts = [f'<p class="notebook">The notebook: docs/notebooks/{notebook.name}</p>']
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        for number, output in enumerate(cell["outputs"]):
            parts.append(_shown(output, page.with_suffix(""), f"{cell['id']}-{number}"))
    head, *rest = parts[1:2], parts[0], *parts[2:]
    return "\n\n".join([*head, *rest]) + "\n"


def _shown(output: dict[str, Any], folder: Path, name: str) -> str:
    """One output: a picture, a table, or text."""
    data = output.get("data", {})
    if "image/png" in data:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.png").write_bytes(base64.b64decode(data["image/png"]))
        return f"![What the cell drew]({folder.name}/{name}.png)"
    if "text/html" in data:
        html = re.sub(r"<style.*?</style>", "", "".join(data["text/html"]), flags=re.DOTALL)
        return '<div class="output">' + "\n".join(line for line in html.splitlines() if line.strip()) + "</div>"
    text = "".join(output.get("text", data.get("text/plain", "")))
    return f"```text\n{text.rstrip()}\n```"
