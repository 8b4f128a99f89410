"""Puts the pages of the site into a folder: those of docs as they are, and what is made of notebooks and of the code."""

from __future__ import annotations

import hashlib
import posixpath
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from docs.site.notebooks import page_of

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
MODULES = (
    "tasks",
    "env",
    "evaluation",
    "agents",
    "episodes",
    "episodes.plots",
    "control",
    "kernel",
    "jax",
    "weather",
    "training",
    "bounds",
    "leaderboard",
    "verification",
)
"""What others write programs with; the reference shows the names in their ``__all__``."""

ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "reports/released/leaderboard.md": "leaderboard.md",
}
"""Pages that are not in docs, and where the site has them."""

_SHOWN_AS_TEXT = {".py", ".toml", ".csv", ".cff", ".yml"}
_LINK = re.compile(r"(?P<code>```.*?```|`[^`\n]+`|^    \S[^\n]*$)|\]\((?P<to>[^)\s]+)\)", re.DOTALL | re.MULTILINE)
_DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.DOTALL | re.MULTILINE)


class SiteError(Exception):
    """The site cannot be built; the message says what to change."""


def sources() -> dict[str, str]:
    """Every page's place in the site by its file in the repository, relative to its root."""
    docs = ROOT / "docs"
    found = {page: page.relative_to(docs).as_posix() for page in [*docs.glob("*.md"), *docs.glob("adr/*.md")]}
    found |= {page: page.relative_to(docs).with_suffix(".md").as_posix() for page in docs.glob("notebooks/*.ipynb")}
    return ELSEWHERE | {page.relative_to(ROOT).as_posix(): place for page, place in sorted(found.items())}


def put_together(folder: Path) -> None:
    """Write configuration and pages of the site into ``folder``, for Zensical to build.

    Raises
    ------
    SiteError
        When a page of docs is in no menu, when a link leads nowhere, or when a diagram has no picture.
    """
    pages, out = sources(), folder / "docs"
    out.mkdir(parents=True)
    shutil.copytree(HERE / "assets", out / "assets")
    (folder / "zensical.toml").write_text(configuration(pages.values()), encoding="utf-8")
    for name in MODULES:
        page = out / "reference" / f"{name}.md"
        page.parent.mkdir(exist_ok=True)
        page.write_text(f"# glbench.{name}\n\n::: glbench.{name}\n", encoding="utf-8")
    for source, place in pages.items():
        page = out / place
        page.parent.mkdir(exist_ok=True)
        text = page_of(ROOT / source, page) if source.endswith(".ipynb") else (ROOT / source).read_text(encoding="utf-8")
        page.write_text(with_diagrams(linked(text, source, pages, out), source, place, out), encoding="utf-8")


def configuration(places: Iterable[str]) -> str:
    """Zensical's configuration, with the menus of decisions and of the reference filled in.

    Raises
    ------
    SiteError
        When a page is in no menu.
    """
    text = (HERE / "zensical.toml").read_text(encoding="utf-8")
    decisions = sorted(place for place in places if place.startswith("adr/"))
    menus = {"DECISIONS": decisions, "REFERENCE": [f"reference/{name}.md" for name in MODULES]}
    for name, listed in menus.items():
        text = text.replace(f"# {name}", " ".join(f'"{place}",' for place in listed))
    missing = sorted(place for place in places if f'"{place}"' not in text)
    if missing:
        msg = f"{', '.join(missing)}: in no menu of the site. Add it to `nav` in docs/site/zensical.toml."
        raise SiteError(msg)
    return text


def linked(text: str, source: str, pages: dict[str, str], out: Path) -> str:
    """``text`` of the page ``source`` with its links leading to places in the site; files that are no pages are copied there.

    Raises
    ------
    SiteError
        When a link leads nowhere.
    """
    base = posixpath.dirname(pages[source])

    def lead(found: re.Match[str]) -> str:
        to = found["to"]
        if to is None or re.match(r"[a-z]+:|#", to):
            return found[0]
        path, _, anchor = to.partition("#")
        if (out / base / path).is_file() and not (ROOT / posixpath.dirname(source) / path).exists():
            return found[0]  # a picture out of a notebook
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        place = pages.get(target) or _copied(target, source, out)
        return f"]({posixpath.relpath(place, base or '.')}{'#' if anchor else ''}{anchor})"

    return _LINK.sub(lead, text)


def _copied(target: str, source: str, out: Path) -> str:
    """Where the site has a copy of the file or folder ``target`` of the repository."""
    file = ROOT / target
    if not file.exists():
        msg = f"{source} points to {target}, which does not exist. Correct the link."
        raise SiteError(msg)
    if file.is_dir():
        copies = [_copied(f"{target}/{one.name}", source, out) for one in sorted(file.iterdir()) if one.is_file()]
        place = f"files/{target}/index.md"
        lines = [f"- [{one.removesuffix('.txt')}]({one})" for one in map(posixpath.basename, copies)]
        (out / place).write_text(f"# {target}\n\n" + "\n".join(lines) + "\n", encoding="utf-8")
        return place
    place = target.removeprefix("docs/") if target.startswith("docs/") else f"files/{target}"
    if file.suffix in _SHOWN_AS_TEXT:
        place += ".txt"  # browsers show text, and offer other files for download
    (out / place).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(file, out / place)
    return place


def with_diagrams(text: str, source: str, place: str, out: Path) -> str:
    """``text`` with pictures for its Mermaid diagrams: a browser would load the program that draws them from the internet.

    Raises
    ------
    SiteError
        When there is no picture of a diagram as it is now.
    """

    def picture(found: re.Match[str]) -> str:
        name = f"{hashlib.sha256(found[1].encode()).hexdigest()[:12]}.svg"
        drawn = HERE / "diagrams" / name
        if not drawn.is_file():
            msg = f"There is no picture of the diagram in {source}. Draw it with Mermaid's mmdc as docs/site/diagrams/{name}."
            raise SiteError(msg)
        copy = out / "diagrams" / name
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(drawn, copy)
        return f"![The diagram]({posixpath.relpath(f'diagrams/{name}', posixpath.dirname(place) or '.')})"

    return _DIAGRAM.sub(picture, text)
