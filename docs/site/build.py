"""Builds one version of the site into its folder, and tells the others of it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from docs.site.links import dead_links
from docs.site.pages import ROOT, SiteError, put_together

SHIM = "https://unpkg.com/iframe-worker/shim"
"""What pages would load from the internet for the search in pages that are opened as files."""

READ_LATER = (
    "reference/", "adr/", "files/", "changelog.html", "leaderboard.html", "architecture.html", "contributing.html", "maintain.html",
    "model-symbols.html", "crop-symbols.html", "nomenclature.html",
)  # fmt: skip
"""Pages, or the beginnings of their places, whose titles the search passes over."""
JOINER = "\u2060"


def build(out: Path, version: str) -> Path:
    """Build the site of this checkout as ``out``/``version``, and return the first page of ``out``.

    The folder takes the place of one that is there. ``versions.js``, which the menu of versions reads, and ``index.html``, which
    leads to the newest release (without one, to ``version``), are written again.

    Raises
    ------
    SiteError
        When a page cannot be made, or a link is dead; then ``out`` stays as it is.
    """
    if not re.fullmatch(r"[\w][\w.-]*", version):
        msg = f"A version's name has letters, digits, dots and hyphens, such as 0.1.0 or dev; got '{version}'."
        raise SiteError(msg)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        put_together(folder)
        (folder / "glbench").symlink_to(ROOT / "glbench")
        built = subprocess.run(
            [sys.executable, "-m", "zensical", "build", "--clean"], cwd=folder, capture_output=True, text=True, check=False
        )
        site = folder / "site"
        if built.returncode or not (site / "index.html").is_file():
            msg = f"Zensical could not build the site:\n{built.stdout}{built.stderr}"
            raise SiteError(msg)
        (site / "404.html").unlink()  # it would have to know where the site is served from
        load_from_here(site)
        rank_pages(site)
        problems = dead_links(site)
        if problems:
            raise SiteError("\n".join(problems))
        place = out / version
        out.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(site, place)
    return tell(out, version)


def load_from_here(site: Path) -> None:
    """Let the pages load the search's helper from the site."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        up = "../" * (len(page.relative_to(site).parts) - 1)
        page.write_text(text.replace(SHIM, f"{up}assets/iframe-worker.js"), encoding="utf-8")


def rank_pages(site: Path) -> None:
    """Let the search look for titles of pages that are read first, and in all others for their text only.

    The search puts titles before text, so that attributes of Python called ``co2`` would come before every page about CO2. A word joiner
    before each word of their titles, which nobody sees or types, hides these from the search; the same words in their text are found. The
    text gets a title that is no part of it.
    """
    file = site / "search.json"
    index = json.loads(file.read_text(encoding="utf-8"))
    for item in index["items"]:
        if item["location"].startswith(READ_LATER):
            item["text"] += f" <p>{item['title']}</p>"
            item["title"] = re.sub(r"[^\W_]+", JOINER + r"\g<0>", item["title"])
            item["path"] = [re.sub(r"[^\W_]+", JOINER + r"\g<0>", part) for part in item["path"]]
    text = json.dumps(index, ensure_ascii=False)
    file.write_text(text, encoding="utf-8")
    (site / "search.js").write_text(f"var __index = {text};", encoding="utf-8")


def tell(out: Path, version: str) -> Path:
    """Write the list of versions in ``out`` and the page that leads to the newest; return that page."""
    found = sorted((file.parent.name for file in out.glob("*/index.html")), key=_order, reverse=True)
    newest = next((name for name in found if name[0].isdigit()), version)
    (out / "versions.js").write_text(f"window.glbenchVersions = {json.dumps(found)};\n", encoding="utf-8")
    page = out / "index.html"
    page.write_text(
        f'<!doctype html><meta charset="utf-8"><title>glbench</title><meta http-equiv="refresh" content="0; url={newest}/index.html">'
        f'<a href="{newest}/index.html">glbench {newest}</a>\n',
        encoding="utf-8",
    )
    return page


def _order(name: str) -> tuple[bool, list[int], str]:
    """Releases by their numbers, before all else."""
    return name[0].isdigit(), [int(number) for number in re.findall(r"\d+", name)], name
