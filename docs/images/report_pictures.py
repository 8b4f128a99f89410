"""The pictures of docs/report.md, from a page: ``python docs/images/report_pictures.py reports/index.html``. Needs chromium."""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

TASK = "Schiphol2010-Delta10-v1"
PICTURES = {
    "report-leaderboard": (f"#/{TASK}", (1240, 1400), "light", 0),
    "report-compare": (f"#/compare/my_agent/rule_based/{TASK}", (1240, 780), "light", 1030),
    "report-phone": (f"#/agent/my_agent/{TASK}", (390, 1000), "dark", 0),
}
"""Name, view, size in pixels, colours, and how far down it is scrolled."""

page_file = Path(sys.argv[1]).resolve().as_uri()
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    for name, (view, (width, height), colours, down) in PICTURES.items():
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=colours)
        page.goto(page_file + view)
        page.wait_for_function("document.querySelector('h1') && !document.querySelector('[aria-busy]')")
        page.evaluate("(down) => scrollTo({ top: down, behavior: 'instant' })", down)
        page.wait_for_function("document.querySelector('.chart').dataset.drawn || scrollY === 0", timeout=60_000)
        page.wait_for_timeout(8_000)  # charts further down are drawn as they come into view
        page.screenshot(path=Path(__file__).with_name(f"{name}.png"))
    browser.close()
