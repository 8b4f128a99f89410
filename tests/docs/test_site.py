"""The documentation site: it is built, every link leads somewhere, it loads nothing from elsewhere, and a phone shows all of it."""

from __future__ import annotations

import importlib
import inspect
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect, sync_playwright

from docs.site.build import build, tell
from docs.site.links import dead_links
from docs.site.notebooks import page_of
from docs.site.pages import MODULES, ROOT, SiteError, configuration, linked, sources, with_diagrams

pytestmark = pytest.mark.slow
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A built site; dead links are an error there."""
    folder = tmp_path_factory.mktemp("site")
    build(folder, "dev")
    return folder


def test_every_page_is_there_and_names_link_to_the_reference(out: Path) -> None:
    site = out / "dev"
    for place in sources().values():
        assert (site / place).with_suffix(".html").is_file()
    for name in MODULES:
        text = (site / "reference" / f"{name}.html").read_text(encoding="utf-8")
        anchors = set(re.findall(r'id="([\w.]+)"', text))
        module = importlib.import_module(f"glbench.{name}")
        public = {one for one in module.__all__ if inspect.isclass(found := getattr(module, one)) or inspect.isfunction(found)}
        missing = {one for one in public if not any(anchor.endswith(f".{one}") for anchor in anchors)}
        assert not missing, f"the reference of glbench.{name} lacks {missing}"


def test_diagrams_are_pictures_and_files_of_the_repository_can_be_read(out: Path) -> None:
    architecture = (out / "dev" / "architecture.html").read_text(encoding="utf-8")
    assert "mermaid" not in architecture
    assert re.search(r'<img[^>]*src="diagrams/\w+\.svg"', architecture)
    energy = (ROOT / "glbench" / "model" / "energy.py").read_bytes()
    assert (out / "dev" / "files" / "glbench" / "model" / "energy.py.txt").read_bytes() == energy


def test_a_dead_link_a_missing_anchor_and_a_script_from_elsewhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<a id="here" href="#here"></a><a href="b.html#there"></a><a href="b.html#nowhere"></a><a href="c.html"></a>'
        '<img src="d.png"><script src="https://example.org/e.js"></script><a href="https://example.org/"></a>'
    )
    (tmp_path / "b.html").write_text('<p id="there"></p>')
    assert dead_links(tmp_path) == [
        "a.html loads https://example.org/e.js from the internet.",
        "a.html points to b.html#nowhere: that page has no such anchor.",
        "a.html points to c.html, which is not there.",
        "a.html points to d.png, which is not there.",
    ]


def test_what_cannot_be_built_is_told(tmp_path: Path) -> None:
    with pytest.raises(SiteError, match=r"new-page\.md: in no menu of the site"):
        configuration([*sources().values(), "new-page.md"])
    with pytest.raises(SiteError, match=r"docs/speed\.md points to docs/gone\.md, which does not exist"):
        linked("[gone](gone.md)", "docs/speed.md", sources(), tmp_path)
    with pytest.raises(SiteError, match=r"no picture of the diagram in docs/speed\.md"):
        with_diagrams("```mermaid\nflowchart LR\n```\n", "docs/speed.md", "speed.md", tmp_path)
    with pytest.raises(SiteError, match=r"got '\.\./up'"):
        build(tmp_path / "out", "../up")
    assert not (tmp_path / "out").exists()


def test_links_change_with_the_place_of_a_page_and_code_stays(tmp_path: Path) -> None:
    text = "[a](docs/speed.md#x) `f[0](docs/speed.md)` [b](https://example.org) [c](CITATION.cff)\n"
    expected = "[a](speed.md#x) `f[0](docs/speed.md)` [b](https://example.org) [c](files/CITATION.cff.txt)\n"
    assert linked(text, "README.md", sources(), tmp_path) == expected
    up = linked("[a](../speed.md) [b](#y)", "docs/adr/0004-stepping-method.md", sources(), tmp_path)
    assert up == "[a](../speed.md) [b](#y)"


def test_a_notebook_becomes_a_page_with_its_pictures(tmp_path: Path) -> None:
    page = tmp_path / "predictive_control.md"
    text = page_of(ROOT / "docs" / "notebooks" / "predictive_control.ipynb", page)
    assert text.startswith("# Predictive control")
    assert "```python\nimport" in text
    assert "<style" not in text
    pictures = re.findall(r"\]\((predictive_control/[\w-]+\.png)\)", text)
    assert len(pictures) >= 3
    for picture in pictures:
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_the_newest_release_is_first_and_is_led_to(tmp_path: Path) -> None:
    for version in ("0.9.0", "dev", "0.10.0"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "index.html").write_text("")
    page = tell(tmp_path, "dev").read_text(encoding="utf-8")
    assert 'url=0.10.0/index.html"' in page
    assert (tmp_path / "versions.js").read_text() == 'window.glbenchVersions = ["0.10.0", "0.9.0", "dev"];\n'


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 390, "height": 800})
        yield page
        browser.close()


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the site with")
def test_a_phone_shows_every_page_at_its_width_without_network_or_errors(out: Path, browser_page: Page) -> None:
    asked, errors = set(), []
    browser_page.on("request", lambda request: asked.add(request.url.split(":")[0]))
    browser_page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    wide = []
    for file in sorted((out / "dev").rglob("*.html")):
        browser_page.goto(file.as_uri())
        if browser_page.evaluate("document.documentElement.scrollWidth") > 390:
            wide.append(file.name)
    assert not wide
    assert not errors
    assert asked <= {"file", "data", "blob", "about"}


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the site with")
def test_search_and_menu_of_versions_work_from_files(out: Path, browser_page: Page) -> None:
    browser_page.set_viewport_size({"width": 1400, "height": 900})
    browser_page.goto((out / "index.html").as_uri())
    browser_page.wait_for_url("**/dev/index.html")
    assert browser_page.locator("select.versions").input_value() == "dev"
    browser_page.keyboard.press("Control+k")
    browser_page.keyboard.type("hygrometer")
    found = browser_page.locator("a[href*='reference/']").filter(has_text="gradient")
    found.first.wait_for(timeout=30_000)


def settled(results: Locator) -> list[str]:
    """Addresses of the search results, once they stay the same for a second: the list changes while parts of the index are searched."""
    deadline = time.monotonic() + 30.0
    before: list[str] = []
    while (now := results.evaluate_all("links => links.map(link => link.href)")) != before or not now:
        assert time.monotonic() < deadline, "the list of results keeps changing"
        before = now
        results.page.wait_for_timeout(1_000)
    return now


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the site with")
@pytest.mark.parametrize("word", ["screen", "heating", "CO2", "yield", "vent", "lamp", "gas", "humidity"])
def test_a_word_of_greenhouses_finds_a_page_for_growers_first(out: Path, browser_page: Page, word: str) -> None:
    browser_page.set_viewport_size({"width": 1400, "height": 900})
    browser_page.goto((out / "dev" / "index.html").as_uri())
    browser_page.keyboard.press("Control+k")
    browser_page.keyboard.type(word)
    results = browser_page.locator(f"a[href*='?h={word}']")
    expect(results.first).to_have_attribute("href", re.compile(r"greenhouse-words\.html"), timeout=30_000)
    assert not any("/reference/" in href for href in settled(results)[:2])
