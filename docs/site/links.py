"""Checks a built site: every link and picture of its pages is there, every anchor exists, and nothing is loaded from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {"img": "src", "script": "src", "link": "href", "source": "src", "iframe": "src", "video": "src"}
_IDLE = {"canonical", "prev", "next", "alternate"}
"""Kinds of ``<link>`` that load nothing."""


class _Page(HTMLParser):
    """Anchors of a page, where its links lead, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what the tag has."""
        found = dict(attrs)
        self.anchors |= {name for key in ("id", "name") if (name := found.get(key))}
        if tag == "a" and (to := found.get("href")) is not None:
            self.links.append(to)
        idle = tag == "link" and set((found.get("rel") or "").split()) & _IDLE
        if tag in _LOADED and not idle and (loaded := found.get(_LOADED[tag])):
            self.loads.append(loaded)


def dead_links(site: Path) -> list[str]:
    """What is wrong with the pages below ``site``, one sentence each; links to other sites are not followed."""
    pages = {file.resolve(): _Page(file.read_text(encoding="utf-8")) for file in sorted(site.rglob("*.html"))}
    problems = []
    for file, page in pages.items():
        name = file.relative_to(site.resolve()).as_posix()
        elsewhere = [loaded for loaded in page.loads if urlsplit(loaded).netloc]
        problems += [f"{name} loads {loaded} from the internet." for loaded in elsewhere]
        for to in [*page.links, *(one for one in page.loads if one not in elsewhere)]:
            parts = urlsplit(to)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchor = unquote(parts.fragment)
            if not target.exists():
                problems.append(f"{name} points to {to}, which is not there.")
            elif anchor and target in pages and anchor not in pages[target].anchors:
                problems.append(f"{name} points to {to}: that page has no such anchor.")
    return list(dict.fromkeys(problems))
